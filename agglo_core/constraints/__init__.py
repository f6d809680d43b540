"""Constraints on what may lie in one part: regions, barriers, ridges, bounds, a metric."""
