"""Rollouts: control sequences in, costs out."""
