"""Smoothers of a level: block sweeps, patches, polynomials."""
