"""Coarse spaces computed from a matrix: aggregates, coarse unknowns, prolongations."""
