"""The discontinuous space: basis, quadrature, sampling."""
