"""Read and write Gmsh's .msh files, versions 2 and 4."""
