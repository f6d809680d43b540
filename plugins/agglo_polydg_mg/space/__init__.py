"""The discontinuous polynomial space: basis, quadrature, evaluation."""
