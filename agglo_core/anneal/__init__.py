"""Annealing of parts: for round shapes, and for solvers."""
