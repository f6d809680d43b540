"""Matrix rows, vertex patches and patch smoothing distributed over ranks."""
