"""Plants: what a planner moves. The protocol, the simulated arm, and the simulated laboratory with its camera."""
