"""The solver petsc_mg, on one mesh and on distributed meshes."""
