"""Mesh and hierarchy files across ranks."""
