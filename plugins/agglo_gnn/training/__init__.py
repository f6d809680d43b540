"""The command ``agglo train``, and code common to the trainings of all networks."""
