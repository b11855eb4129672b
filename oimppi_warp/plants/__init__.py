"""Plants, the systems that planners control: the protocol, the simulated arm, and the simulated lab with its camera."""
