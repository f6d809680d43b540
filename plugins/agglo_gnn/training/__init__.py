"""The command that trains networks, and the parts that all trainings share."""
