"""Plants, which a planner moves: the protocol, the simulated arm, and the simulated laboratory with its camera."""
