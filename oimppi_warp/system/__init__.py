"""The machine: what it has, what is wrong with it, and kernels compiled for it ahead of time."""
