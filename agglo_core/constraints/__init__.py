"""Constraints on parts: material regions, barriers, boundary ridges, size bounds, and metrics."""
