"""Run laws and collect results, in child processes, in pytest and for the reference pages."""
