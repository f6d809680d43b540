"""Gmsh's .msh files of versions 2 and 4."""
