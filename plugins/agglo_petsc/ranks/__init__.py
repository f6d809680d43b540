"""Rows, vertex patches and sweeps divided among ranks."""
