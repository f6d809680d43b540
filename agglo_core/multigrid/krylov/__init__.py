"""Conjugate gradients: iteration, stopping test, restarts."""
