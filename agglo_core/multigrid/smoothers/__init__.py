"""Smoothers of multigrid levels: block sweeps, patches, polynomials."""
