"""Level smoothers: block sweeps, patches, polynomials."""
