"""Convert points and cells to a mesh, and meshes to lists of cells and faces."""
