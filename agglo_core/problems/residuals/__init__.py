"""Residual measures, and their limits due to rounding."""
