"""Test cases for multigrid components: positive definite systems on drawn meshes, with a coarser level."""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Any, Final, Literal

import numpy as np
from scipy import sparse
from scipy.sparse.linalg import splu

from agglo_core.arrays import Float, Int, frozen_float, frozen_int
from agglo_core.conformance.base import Case
from agglo_core.conformance.inputs.drawn import DrawnGraph, DrawnMesh, Layout, Recipe, drawn_labels
from agglo_core.graph import Graph
from agglo_core.problems import Coarsening, MultigridLevel, Patches

PARTS: Final = ("transfer", "coarse_operator", "coarse_solver")
"""Kinds with cases in this module."""

Couplings = Literal["even", "uneven", "wide"]
COUPLINGS: tuple[Couplings, ...] = ("even", "uneven", "wide")
"""Couplings of drawn systems: by the interfaces, times 1 to 100, or times 1e-3 to 1e3."""


_NINE = DrawnGraph(DrawnMesh(cells=9))


@dataclass(frozen=True, repr=False)
class DrawnLevel(Recipe):
    """Recipe for a multigrid level: a shifted graph Laplacian with a coarser level.

    Parameters
    ----------
    drawn : DrawnGraph
        The cells, in one connected block.
    layout, parts : str, int
        Coarse parts, as in :func:`drawn_labels`.
    width : int
        Number of unknowns per cell.
    mixing : float
        Coupling of the unknowns of a cell: entries off the diagonal of a matrix of ones.
    uneven : bool
        Omit the last unknown of one cell in steps to the coarser level, if cells have several.
    rotated : bool
        Add a rotation to the near-null vectors, if cells have several unknowns and are at least 16.
    couplings : str
        One of :data:`COUPLINGS`.
    shift : float
        Diagonal term relative to the mean coupling.
    steps : int
        Smoothing steps.
    corrected : bool
        Pass the coarse correction to the smoother.
    rediscretised : bool
        Make the inherited matrix differ from the matrix of the level.
    unit : float
        Factor of the matrix.

    Examples
    --------
    >>> from agglo_core.conformance import DrawnGraph, DrawnLevel, DrawnMesh
    >>> DrawnLevel(DrawnGraph(DrawnMesh(cells=9)), width=2).level.A.shape
    (18, 18)
    """

    drawn: DrawnGraph = _NINE
    layout: Layout = "strips"
    parts: int = 2
    width: int = 1
    mixing: float = 0.05
    uneven: bool = False
    rotated: bool = False
    couplings: Couplings = "even"
    shift: float = 0.05
    steps: int = 1
    corrected: bool = False
    rediscretised: bool = False
    unit: float = 1.0

    @property
    def level(self) -> MultigridLevel:
        """The level as smoothers receive it."""
        graph, seed = self.drawn.graph, self.drawn.drawn.seed
        labels = drawn_labels(graph, self.layout, self.parts, seed)
        A = self.unit * laplacian_of(graph, self.couplings, self.shift, seed)
        level = level_of(graph, A, labels, self.width, self.mixing, self.corrected, self.steps)
        if self.rediscretised:
            level = replace(level, inherited=level.A + 0.5 * sparse.diags_array(level.A.diagonal()))
        return level

    @property
    def smoothing(self) -> tuple[MultigridLevel, Float, Float]:
        """The arguments of a smoother: level, right-hand side and approximation."""
        given: tuple[MultigridLevel, Float, Float] = question("", self.level).given
        return given

    @property
    def coarsening(self) -> tuple[Coarsening, Any]:
        """The arguments of a coarse operator: the step to the coarser level, and its prolongation."""
        step = coarsening_of(self.level, self.width)
        if self.width > 1 and self.rotated and self.drawn.graph.n >= 16:
            step = _with_rotation(step, self.drawn.graph)
        return _without_some(step) if self.width > 1 and self.uneven else (step, step.injected)

    @property
    def system(self) -> tuple[Any, Float]:
        """The arguments of a coarse solver: matrix and right-hand side."""
        A = self.coarsening[0].A
        return A, _load(A.shape[0])

    def case(self, kind: str) -> Case:
        """Return the test case for a kind of multigrid component, with the code that makes it."""
        variables, attribute = {
            "smoother": ("level, b, x", "smoothing"),
            "coarse_solver": ("A, b", "system"),
        }.get(kind, ("step, P", "coarsening"))
        given = getattr(self, attribute)[: 1 if kind == "transfer" else None]
        name = f"a level of {self.drawn.graph.n * self.width} unknowns"
        return Case(name, given, f"{variables} = {self!r}.{attribute}")


def laplacian_of(graph: Graph, couplings: Couplings = "even", shift: float = 0.05, seed: int = 0) -> Any:
    """Return the shifted graph Laplacian ``(n, n)``, with couplings of mean about 1."""
    decades = {"even": (0.0, 0.0), "uneven": (0.0, 2.0), "wide": (-3.0, 3.0)}[couplings]
    upper = sparse.triu(graph.to_scipy(), format="coo")
    mean = float(upper.data.mean()) if upper.nnz else 1.0
    weights = upper.data / mean * 10.0 ** np.random.default_rng(seed).uniform(*decades, upper.nnz)
    links = sparse.csr_array(sparse.coo_array((weights, upper.coords), shape=upper.shape))
    links = links + links.T
    return sparse.csr_array(sparse.diags_array(links.sum(axis=1) + shift) - links)


def level_of(
    graph: Graph,
    scalar: Any,
    labels: Int,
    per_cell: int = 1,
    mixing: float = 0.05,
    corrected: bool = False,
    steps: int = 2,
) -> MultigridLevel:
    """Return a multigrid level whose coarse unknowns are the parts of ``labels``.

    ``scalar`` is the matrix for one unknown per cell. Each patch is a cell with its neighbours.
    """
    coupling = (1.0 - mixing) * np.eye(per_cell) + mixing * np.ones((per_cell, per_cell))
    A = sparse.csr_array(sparse.kron(scalar, coupling))
    inject = sparse.csr_array((np.ones(graph.n), (np.arange(graph.n), labels)))
    P = sparse.csr_array(sparse.kron(inject, sparse.eye_array(per_cell)))
    P.eliminate_zeros()
    solve = splu(sparse.csc_array(P.T @ A @ P)).solve

    def correction(residual: Float) -> Float:
        return np.asarray(P @ solve(P.T @ residual))

    around = sparse.csr_array(graph.to_scipy() + sparse.eye_array(graph.n))
    patches = Patches(frozen_int(around.indptr), frozen_int(around.indices))
    offsets, cells = frozen_int(np.arange(graph.n + 1) * per_cell), frozen_int(np.arange(graph.n))
    return MultigridLevel(A, A, offsets, cells, P, correction if corrected else None, steps, patches)


def coarsening_of(level: MultigridLevel, width: int) -> Coarsening:
    """Return the step from a level to the coarser one, with constants as near-null vectors."""
    A, P = (sparse.bsr_array(matrix, blocksize=(width, width)) for matrix in (level.A, level.P))
    n = len(level.labels)
    parents = frozen_int(level.P[::width].indices // width)

    def rediscretised() -> Any:
        return sparse.csr_array(0.9 * (P.T @ (A @ P)))

    near_null = frozen_float(np.kron(np.ones((n, 1)), np.eye(width)))
    return Coarsening(A, level.block_offsets, level.labels, parents, parents, near_null, P, rediscretised)


def _with_rotation(step: Coarsening, graph: Graph) -> Coarsening:
    """Add a rotation of the first two unknowns about the mean centroid to the near-null vectors."""
    assert step.near_null is not None
    x, y = (graph.centroids - graph.centroids.mean(axis=0))[:, :2].T / np.ptp(graph.centroids)
    rotation = np.zeros(step.near_null.shape[:1])
    width = step.near_null.shape[1]
    rotation[::width], rotation[1::width] = -y, x
    return replace(step, near_null=frozen_float(np.column_stack((step.near_null, rotation))))


def _without_some(step: Coarsening) -> tuple[Coarsening, Any]:
    """Omit the last unknown of a cell, and return the step and the prolongation of constants.

    The cell is the one with fewest neighbours, so that no other cell becomes isolated. The unknowns of a
    cell are not coupled, so that constants remain near-null vectors.
    """
    assert step.near_null is not None
    width = int(step.block_offsets[1])
    cell = int(np.diff(step.A.indptr).argmin())
    kept = np.delete(np.arange(step.A.shape[0]), width * cell + width - 1)
    offsets = frozen_int(np.searchsorted(kept, step.block_offsets))
    P = sparse.csr_array(step.injected)[kept]
    P = P[:, np.flatnonzero(abs(P).sum(axis=0))]
    links = sparse.coo_array(step.A)
    rows, columns = links.coords
    links.data[rows % width != columns % width] = 0.0
    shifts, links = links.sum(axis=1)[kept], sparse.csr_array(links)[kept][:, kept]
    A = sparse.csr_array(links + sparse.diags_array(shifts - links.sum(axis=1)))
    near_null = frozen_float(step.near_null[kept])
    return Coarsening(A, offsets, step.labels, step.coarse_labels, step.parents, near_null), P


def question(name: str, level: MultigridLevel) -> Case:
    """Return the test case to smooth a random ``x``, which is not the solution, on a multigrid level."""
    n = level.A.shape[0]
    x = np.random.default_rng(n).standard_normal(n)
    return Case(name, (level, _load(n), frozen_float(x)))


def _load(n: int) -> Float:
    return frozen_float(1.0 + np.cos(np.arange(n) + 1.0))  # with a constant part, the smoothest mode
