"""Solver, problem, runs and files of the commands that solve."""
