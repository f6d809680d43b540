"""Bisectors that split pieces of a mesh, and the kernels that split a whole level in one call."""
