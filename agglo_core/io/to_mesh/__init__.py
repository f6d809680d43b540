"""Convert points and cells to a mesh, and meshes to cell and face lists."""
