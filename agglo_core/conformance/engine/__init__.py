"""Test components against the laws: directly, in child processes, in pytest and for reference pages."""
