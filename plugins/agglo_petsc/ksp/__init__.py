"""Multigrid in a user's KSP: set-up, options, report, and a checked solve."""
