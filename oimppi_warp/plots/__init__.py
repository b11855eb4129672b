"""Plots and a film of an episode, drawn from its record."""
