"""Geometry of a scene: footprints, distance fields, the arm's kinematics and reach, and the feasibility of a task."""
