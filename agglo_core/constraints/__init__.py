"""Constraints on parts: regions, barriers, ridges, bounds and metrics."""
