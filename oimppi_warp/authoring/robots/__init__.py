"""Robots as data: written as USD, and imported from a URDF or a USD articulation."""
