"""Checks that find, before a run, every problem that would stop or spoil it."""
