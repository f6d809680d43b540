"""Linear elasticity: bilinear form, penalty, data, norms and multigrid levels."""
