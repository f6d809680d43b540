"""Conjugate gradients: iteration, stopping tests, restarts."""
