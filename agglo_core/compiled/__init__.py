"""Compilation and disk cache of kernels (compiled functions), and kernels shared by several folders.

A kernel stands next to the code that uses it, and is tested against a slow, obvious numpy implementation.
Kernels are compiled on first use, or while a wheel is built. Inputs are read-only arrays and outputs are new
arrays, so every kernel has one signature.
"""

from agglo_core.compiled.compiling import helper, kernel

__all__ = ["helper", "kernel"]
