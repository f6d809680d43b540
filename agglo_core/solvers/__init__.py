"""Solvers that need no discretisation of their own, and what solvers of plugins share."""
