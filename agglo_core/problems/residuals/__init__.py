"""Sizes of residuals, and how far rounding lets them fall."""
