"""Multigrid in a KSP: set-up, options, report, checked solve."""
