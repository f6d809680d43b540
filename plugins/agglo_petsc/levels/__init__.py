"""Levels from labels of cells: aggregates, near-null vectors, prolongations."""
