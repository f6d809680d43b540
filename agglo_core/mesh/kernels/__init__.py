"""Kernels of meshes: faces, loops, chains of edges, geometry of cells."""
