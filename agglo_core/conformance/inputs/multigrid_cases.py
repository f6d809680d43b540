"""Test cases for multigrid components: positive definite systems on drawn meshes, with a coarser level."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any, Final, Literal

import numpy as np
from scipy import sparse
from scipy.sparse.linalg import splu

from agglo_core.arrays import Float, Int, frozen_float, frozen_int
from agglo_core.conformance.base.case import Case
from agglo_core.conformance.inputs.drawn import DrawnGraph, DrawnMesh, Layout, Recipe, drawn_labels
from agglo_core.graph import Graph
from agglo_core.problems import Coarsening, MultigridLevel, Patches

PARTS: Final = ("transfer", "coarse_operator", "coarse_solver")
"""Kinds with cases in this module."""

Couplings = Literal["even", "uneven", "wide"]
COUPLINGS: tuple[Couplings, ...] = ("even", "uneven", "wide")
"""Couplings of drawn systems: by the interfaces, times 1 to 100, or times 1e-3 to 1e3."""


_NINE = DrawnGraph(DrawnMesh(cells=9))
_SQUARES = DrawnGraph(DrawnMesh(cells=64))


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
    couplings: Couplings = "even"
    shift: float = 0.05
    steps: int = 1
    corrected: bool = False
    rediscretised: bool = False
    unit: float = 1.0

    @property
    def level(self) -> MultigridLevel:
        """The level as smoothers receive it."""
        graph = self.drawn.graph
        labels = drawn_labels(graph, self.layout, self.parts, self.drawn.drawn.seed)
        A = self.unit * laplacian_of(graph, self.couplings, self.shift, self.drawn.drawn.seed)
        return level_of(
            graph,
            A,
            labels,
            per_cell=self.width,
            corrected=self.corrected,
            steps=self.steps,
            rediscretised=self.rediscretised,
        )

    @property
    def smoothing(self) -> tuple[MultigridLevel, Float, Float]:
        """The arguments of a smoother: level, right-hand side and approximation."""
        given: tuple[MultigridLevel, Float, Float] = question("", self.level).given
        return given

    @property
    def coarsening(self) -> tuple[Coarsening, Any]:
        """The arguments of a coarse operator: the step to the coarser level, and its prolongation."""
        step = coarsening_of(self.level, self.width)
        return step, step.injected

    @property
    def system(self) -> tuple[Any, Float]:
        """The arguments of a coarse solver: matrix and right-hand side."""
        step, _ = self.coarsening
        return step.A, _load(step.A.shape[0])


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
    *,
    per_cell: int = 1,
    corrected: bool = False,
    steps: int = 2,
    rediscretised: bool = False,
) -> MultigridLevel:
    """Return a multigrid level whose coarse unknowns are the parts of ``labels``.

    ``scalar`` is the matrix for one unknown per cell. Each patch is a cell with its neighbours.
    """
    inject = sparse.csr_array((np.ones(graph.n), (np.arange(graph.n), labels)))
    A = sparse.csr_array(sparse.kron(scalar, _coupling(per_cell)))
    P = sparse.csr_array(sparse.kron(inject, sparse.eye_array(per_cell)))
    P.eliminate_zeros()
    offsets = frozen_int(np.arange(graph.n + 1) * per_cell)
    solve = splu(sparse.csc_array(P.T @ A @ P)).solve

    def correction(residual: Float) -> Float:
        return np.asarray(P @ solve(P.T @ residual))

    # Patches from the rows of adjacency plus identity.
    around = sparse.csr_array(graph.to_scipy() + sparse.eye_array(graph.n))
    patches = Patches(frozen_int(around.indptr), frozen_int(around.indices))
    inherited = sparse.csr_array(A + 0.5 * sparse.diags_array(A.diagonal())) if rediscretised else A
    cells = frozen_int(np.arange(graph.n))
    return MultigridLevel(A, inherited, offsets, cells, P, correction if corrected else None, steps, patches)


def levels() -> list[Case]:
    """Return the standard test cases for smoothers, with one or three unknowns per cell.

    One level has a coarse correction. ``x`` is random and not a solution.
    """
    jittered = DrawnGraph(DrawnMesh(cells=63, jitter=0.25))
    recipes = {
        "squares": DrawnLevel(_SQUARES, "grown", 16, steps=2),
        "squares with a coarse correction": DrawnLevel(_SQUARES, "grown", 16, steps=2, corrected=True),
        "quadrilaterals": DrawnLevel(jittered, parts=7, steps=2),
        "three unknowns per cell": DrawnLevel(_SQUARES, "grown", 16, width=3, steps=2),
    }
    return [Case(name, recipe.smoothing) for name, recipe in recipes.items()]


def single_unknown() -> list[Case]:
    """Return a test case for smoothers with a single unknown."""
    return [Case("one unknown", DrawnLevel(DrawnGraph()).smoothing)]


def _coupling(width: int) -> Float:
    """Return a symmetric positive definite matrix ``(width, width)`` that couples the unknowns of a cell."""
    return np.eye(width) + 0.05 * (np.ones((width, width)) - np.eye(width))


def question(name: str, level: MultigridLevel) -> Case:
    """Return the test case to smooth a random ``x`` on a multigrid level."""
    n = level.A.shape[0]
    x = np.random.default_rng(n).standard_normal(n)
    return Case(name, (level, _load(n), frozen_float(x)))


def _load(n: int) -> Float:
    return frozen_float(1.0 + np.cos(np.arange(n) + 1.0))  # with a constant part, the smoothest mode


def coarsenings(kind: str) -> list[Case]:
    """Return the standard test cases of coarsenings, with one or three unknowns per cell."""
    jittered = DrawnGraph(DrawnMesh(cells=63, jitter=0.25))
    recipes = {
        "squares": DrawnLevel(_SQUARES, "grown", 16),
        "quadrilaterals": DrawnLevel(jittered, parts=7),
        "three unknowns per cell": DrawnLevel(_SQUARES, "grown", 16, width=3),
    }
    return [coarsening_case(kind, name, recipe) for name, recipe in recipes.items()]


def one_part(kind: str) -> list[Case]:
    """Return degenerate coarsenings: of a single cell, and of a mesh into a single part."""
    recipes = {
        "one unknown": DrawnLevel(DrawnGraph()),
        "all in one part": DrawnLevel(DrawnGraph(DrawnMesh(cells=12)), parts=1),
    }
    return [coarsening_case(kind, name, recipe) for name, recipe in recipes.items()]


def coarsening_case(kind: str, name: str, recipe: DrawnLevel) -> Case:
    """Return the test case of a transfer, coarse operator or coarse solver, with the code that makes it."""
    if kind == "coarse_solver":
        return Case(name, recipe.system, f"A, b = {recipe!r}.system")
    given: tuple[Any, ...] = recipe.coarsening
    return Case(name, given[:1] if kind == "transfer" else given, f"step, P = {recipe!r}.coarsening")


def coarsening_of(level: MultigridLevel, width: int) -> Coarsening:
    """Return the step from a level to the coarser one, with constants as near-null vectors."""
    A, P = (sparse.bsr_array(matrix, blocksize=(width, width)) for matrix in (level.A, level.P))
    n = len(level.labels)
    parents = frozen_int(level.P[::width].indices // width)

    def rediscretised() -> Any:
        return sparse.csr_array(0.9 * (P.T @ (A @ P)))

    near_null = frozen_float(np.kron(np.ones((n, 1)), np.eye(width)))
    return Coarsening(A, level.block_offsets, level.labels, parents, parents, near_null, P, rediscretised)
