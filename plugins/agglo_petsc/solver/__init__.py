"""The solver ``petsc_mg``, for a mesh on one process and for distributed meshes."""
