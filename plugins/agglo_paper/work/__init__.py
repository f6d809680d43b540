"""The work: meshes, methods, what is computed of them, and where results are kept."""
