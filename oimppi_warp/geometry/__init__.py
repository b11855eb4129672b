"""Geometry of a scene: footprints, distance fields, the arm's kinematics and reach, and whether a task can be done."""
