"""Simplify meshes: merge chains of collinear edges and coplanar faces into single faces."""
