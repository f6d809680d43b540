"""From the contents of a file to a mesh: cells and faces as lists, checks, hanging vertices."""
