"""Kernels of the sampling-based optimizers: sampling and updates."""
