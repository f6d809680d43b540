"""Turn the points and cells of a file into a mesh, and a mesh into lists of cells and faces."""
