"""Compiled loops for meshes: faces, boundary loops, edge chains, cell geometry."""
