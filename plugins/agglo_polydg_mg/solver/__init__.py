"""The default solver and its choices."""
