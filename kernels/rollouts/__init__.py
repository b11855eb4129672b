"""Rollouts, which compute the costs of control sequences."""
