"""Coarse spaces of the default solver: a continuous auxiliary space and its multigrid levels."""
