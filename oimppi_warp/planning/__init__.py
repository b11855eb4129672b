"""The planner: object level, robot level, and the methods MPPI, SOI and CLOI."""
