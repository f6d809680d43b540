"""Convert the points and cells of a file to a mesh, and back to lists of cells and faces."""
