"""The command ``agglo train``, and code common to all network trainings."""
