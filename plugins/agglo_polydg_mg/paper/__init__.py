"""The paper's multigrid, and multigrid composed by name."""
