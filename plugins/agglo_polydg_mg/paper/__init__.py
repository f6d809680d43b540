"""The paper's multigrid, and multigrid composed of named parts."""
