"""Rollout engines: one state and K control sequences in, K costs out."""
