"""Numba kernels, one file per concern; each is tested against a slow, obvious numpy implementation.

Signatures are compiled on first use and cached on disk, so the first run on a fresh machine is
slower. Inputs are read-only arrays, outputs are fresh: every kernel has one signature.
"""

from agglo_core.kernels.compiling import helper, kernel

__all__ = ["helper", "kernel"]
