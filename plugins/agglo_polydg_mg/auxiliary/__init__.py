"""Coarse spaces of the default solver: the continuous space and its levels."""
