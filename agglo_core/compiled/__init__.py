"""Compiled code: how kernels are compiled and kept on disk, and the kernels that several folders share.

A kernel stands beside the code that uses it and is tested against a slow, obvious numpy implementation.
Kernels are compiled while a wheel is built, or on first use. Inputs are read-only arrays, outputs are fresh:
every kernel has one signature.
"""

from agglo_core.compiled.compiling import helper, kernel

__all__ = ["helper", "kernel"]
