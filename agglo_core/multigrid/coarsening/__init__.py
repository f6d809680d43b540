"""Coarse spaces from a matrix: aggregates, coarse points, prolongations."""
