"""Numba kernels, one file per concern; each is tested against a slow, obvious numpy implementation.

Signatures are compiled while a wheel is built, or on first use, and kept on disk. Inputs are read-only
arrays, outputs are fresh: every kernel has one signature.
"""

from agglo_core.kernels.compiling import helper, kernel

__all__ = ["helper", "kernel"]
