"""The command that trains networks, and what all of them share."""
