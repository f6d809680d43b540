"""Measures of residuals, and their limits due to rounding."""
