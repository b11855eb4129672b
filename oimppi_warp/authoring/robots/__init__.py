"""Robots as data, written as USD, and made from a URDF or from a USD articulation."""
