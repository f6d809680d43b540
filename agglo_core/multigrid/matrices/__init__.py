"""Block matrices and their products."""
