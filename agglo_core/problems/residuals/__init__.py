"""Sizes of residuals, and their limits by rounding."""
