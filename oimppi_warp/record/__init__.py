"""The record of an episode: its log and its metrics."""
