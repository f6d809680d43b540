"""Simplify meshes: one face instead of straight runs of edges and flat patches of faces."""
