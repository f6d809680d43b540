"""Bisectors that split mesh pieces, and kernels that split a whole level in one call."""
