"""The training command, and the common parts of all trainings."""
