"""The solver petsc_mg, for a mesh on one rank and for distributed meshes."""
