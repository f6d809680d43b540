"""What the commands that solve share: solver, problem, runs, files."""
