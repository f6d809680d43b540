"""Simulated annealing of parts, for solvers or for round shapes."""
