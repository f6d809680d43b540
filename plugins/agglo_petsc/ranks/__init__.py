"""Rows, vertex patches and sweeps distributed over ranks."""
