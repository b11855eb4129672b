"""Sampling-based optimizers of a control sequence, used at both levels: MPPI and CEM."""
