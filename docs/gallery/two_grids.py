"""A coarse level speeds up a solver

The Laplacian of the dual graph, solved by conjugate gradients of scipy: preconditioned by its diagonal,
then also by an exact solve on 60 agglomerates, to which the hierarchy's prolongation leads.
"""

import numpy as np
from scipy import sparse
from scipy.sparse.linalg import LinearOperator, cg, splu

import agglo_core as agglo

mesh = agglo.samples.voronoi(2000, seed=1)
hierarchy = agglo.agglomerate(mesh, n_parts=60)
weights = mesh.graph.to_scipy()
A = sparse.csc_array(sparse.diags_array(weights.sum(axis=1) + mesh.graph.boundary) - weights)
P = hierarchy.prolongation(0)
coarse = splu(sparse.csc_array(P.T @ A @ P))


def residuals(preconditioner):
    """Norms of the residual until it is 1e-8 of the first."""
    b, norms = mesh.cell_measures, []
    M = LinearOperator(A.shape, matvec=preconditioner, dtype=float)
    cg(A, b, rtol=1e-8, M=M, callback=lambda x: norms.append(np.linalg.norm(b - A @ x) / np.linalg.norm(b)))
    return norms


one_level = residuals(lambda r: r / A.diagonal())
two_levels = residuals(lambda r: r / A.diagonal() + P @ coarse.solve(P.T @ r))
iterations = (len(one_level), len(two_levels))

if __name__ == "__main__":
    from matplotlib import pyplot

    pyplot.figure(figsize=(6, 3.5), layout="constrained")
    pyplot.semilogy(one_level, label="diagonal")
    pyplot.semilogy(two_levels, label="diagonal and 60 agglomerates")
    pyplot.xlabel("iteration")
    pyplot.ylabel("relative residual")
    pyplot.legend()
    pyplot.savefig("two_grids.png", dpi=160)
