"""Multigrid levels from cell labels: aggregates, near-null vectors, prolongations."""
