"""Running a planner on a plant: the control loop, the estimator and the episode."""
