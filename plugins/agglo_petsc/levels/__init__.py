"""From labels of cells to the levels that PETSc gets: prolongations and near-null vectors."""
