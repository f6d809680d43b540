"""Solvers without levels: direct ones and plain conjugate gradients."""
