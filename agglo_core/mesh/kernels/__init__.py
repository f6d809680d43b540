"""Mesh kernels: faces, loops, edge chains, cell geometry."""
