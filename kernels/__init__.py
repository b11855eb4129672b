"""Warp kernels: one source for CPU and CUDA. Imported as ``oimppi_warp.kernels``."""
