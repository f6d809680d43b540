"""Common parts of the commands that solve: solver, problem, runs and files."""
