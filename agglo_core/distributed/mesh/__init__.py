"""Meshes across ranks: cells, ghosts, shared faces and points, redistribution."""
