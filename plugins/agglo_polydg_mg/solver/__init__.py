"""Default solver and its choices."""
