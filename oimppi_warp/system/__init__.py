"""The machine: its properties, problems with it, and ahead-of-time compilation of kernels."""
