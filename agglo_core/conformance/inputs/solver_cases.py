"""Recipes of test cases for solvers: diffusion and linear systems on hierarchies, and known solutions."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace

import numpy as np
from scipy import sparse

from agglo_core.arrays import Float, Int, frozen_float, frozen_int
from agglo_core.conformance.base import Case
from agglo_core.conformance.inputs.drawn import DrawnMesh, Layout, Recipe, drawn_labels
from agglo_core.conformance.inputs.multigrid_cases import laplacian_of
from agglo_core.graph import Graph
from agglo_core.hierarchy import Hierarchy
from agglo_core.mesh import Mesh
from agglo_core.problems import Diffusion, Field, Linear, Problem

ORDINARY = ("diffusion", "even", "uneven")
"""Problems that a solver must solve, unless it refuses all of their kind."""

DEFINITE = ("contrast", "units", "coupled", "ill-conditioned")
"""Symmetric positive definite systems that are hard to precondition or to solve accurately."""

UNLIKE_DIFFUSION = (
    "nonsymmetric",
    "slightly nonsymmetric",
    "triangular",
    "indefinite",
    "without curvature",
    "unequal cells",
    "whole numbers",
    "entries stored twice",
)
"""Systems that a solver may refuse."""

UNDEFINED = ("undefined source", "undefined right-hand side")
"""Problems with data that are NaN."""

FORMS = ("numbers", "cells", "functions")
"""Forms of coefficient and source: numbers, one rough value per cell, or functions."""

SIDES = -1, 101, 2, 300, 7, 1000
"""Boundary tags of the low and high sides of a plate along x, y and z, as mesh generators may number them."""


_SIXTEEN = DrawnMesh(cells=16)


@dataclass(frozen=True, repr=False)
class DrawnProblem(Recipe):
    """Recipe for a problem on a hierarchy.

    Parameters
    ----------
    drawn : DrawnMesh
        The mesh.
    sort : str
        One of :data:`ORDINARY`, :data:`DEFINITE`, :data:`UNLIKE_DIFFUSION` and :data:`UNDEFINED`, or
        ``"singular"``.
    layout, parts : str, int
        Agglomerates of the first level, as in :func:`drawn_labels`.
    levels : int
        Number of levels; each further level has a third of the parts.
    width : int
        Number of unknowns per cell of a linear system.
    form : str
        One of :data:`FORMS`.
    meshless : bool
        Leave the mesh of a linear system out of the hierarchy.

    Examples
    --------
    >>> from agglo_core.conformance import DrawnProblem
    >>> problem, hierarchy = DrawnProblem(sort="uneven", width=2).posed
    >>> problem.A.shape, hierarchy
    ((32, 32), Hierarchy(16 cells -> 4 parts))
    """

    drawn: DrawnMesh = _SIXTEEN
    sort: str = "diffusion"
    layout: Layout = "strips"
    parts: int = 4
    levels: int = 1
    width: int = 1
    form: str = "numbers"
    meshless: bool = False

    @property
    def posed(self) -> tuple[Problem, Hierarchy]:
        """Problem and hierarchy, built anew at each access."""
        mesh = self.drawn.mesh
        graph: Graph = mesh.graph
        if self.sort == "without curvature":
            finest = np.arange(graph.n) // 4
        else:
            parts = min(self.parts, (graph.n + 1) // 2)  # some levels must be coarser than the mesh
            finest = drawn_labels(graph, self.layout, parts, self.drawn.seed)
        labels = [frozen_int(finest // 3**level) for level in range(self.levels)]
        if self.sort == "diffusion":
            return _diffusion(mesh, self.form), on_levels(mesh, *labels)
        if self.sort == "undefined source":
            return Diffusion(source=np.nan), on_levels(mesh, *labels)
        system = _system(self.sort, graph, self.width, self.drawn.seed)
        if self.meshless:
            targets = [{"n_parts": int(each.max()) + 1} for each in labels]
            return system, Hierarchy(None, graph, labels, targets, nested=True)
        return system, on_levels(mesh, *labels)

    @property
    def case(self) -> Case:
        """The test case, named by problem and mesh."""
        posed = self.posed
        name = f"a problem {self.sort!r} on {posed[1].graph.n} {self.drawn.family}"
        name += f" with {self.width} unknowns per cell" * (self.width > 1)
        return Case(name, posed, f"problem, hierarchy = {self!r}.posed")


@dataclass(frozen=True, repr=False)
class DrawnPlate(Recipe):
    """Recipe for a diffusion problem on rectangles or boxes whose solution is linear on both sides of a jump.

    Parameters
    ----------
    drawn : DrawnMesh
        Mesh of rectangles or boxes, neither rotated nor distorted; its seed rotates the tags of the sides.
    left, right : float
        Coefficient on both sides of a plane across x, unless it is given as a number.
    form : str
        One of :data:`FORMS`, for the coefficient.
    fluxes : int
        Number of sides with Neumann data, counted from the last one.
    merged : bool
        Use one boundary tag for all sides with Dirichlet data and one for all with Neumann data.
    tag : str
        Name of the face tag with the sides.

    Examples
    --------
    >>> from agglo_core.conformance import DrawnPlate
    >>> problem, hierarchy, exact = DrawnPlate(fluxes=1).posed
    >>> problem.dirichlet.keys(), problem.neumann.keys()
    (dict_keys([-1, 101, 2]), dict_keys([300]))
    """

    drawn: DrawnMesh = _SIXTEEN
    left: float = 1.0
    right: float = 1.0
    form: str = "numbers"
    fluxes: int = 0
    merged: bool = False
    tag: str = "boundary"

    @property
    def case(self) -> Case:
        """The test case, whose argument is this recipe."""
        return Case(
            f"a plate of {self.drawn.cells} {self.drawn.family}",
            (self,),
            f"problem, hierarchy, exact = {self!r}.posed",
        )

    @property
    def posed(self) -> tuple[Diffusion, Hierarchy, Callable[[Float], Float]]:
        """Problem, hierarchy and exact solution."""
        mesh, right = self.drawn.mesh, self.left if self.form == "numbers" else self.right
        low, extent = mesh.points.min(axis=0), np.ptp(mesh.points, axis=0)
        planes = np.unique(mesh.points[:, 0])
        jump = planes[len(planes) // 2]  # along a row of faces

        def kappa(points: Float) -> Float:
            return np.where(points[:, 0] < jump, self.left, right)

        def exact(points: Float) -> Float:
            along = 5.0 * (points[:, 0] - jump) / extent[0] / kappa(points)
            slopes = np.array([-2.0, 3.0])[: mesh.dim - 1]
            return np.asarray(1.0 + along + (points - low)[:, 1:] / extent[1:] @ slopes)

        def flux(points: Float) -> Float:
            # Outward, on the side on which the point lies.
            t = (points - low) / extent
            axis = np.abs(t - 0.5).argmax(axis=1)
            outward = np.sign(np.take_along_axis(t, axis[:, None], 1)[:, 0] - 0.5)
            slopes = np.array([5.0, -2.0, 3.0])[axis] / extent[axis]
            return np.asarray(outward * slopes * np.where(axis == 0, 1.0, kappa(points)))

        # Tag the sides; the last ones have Neumann data.
        count = 2 * mesh.dim
        is_flux = np.arange(count) >= count - self.fluxes
        tags = np.roll(SIDES[:count], self.drawn.seed)
        if self.merged:
            tags = np.where(is_flux, tags[0], tags[1])
        t = (mesh.face_centroids - low) / extent
        beyond = np.stack((t, 1.0 - t), axis=2).reshape(mesh.n_faces, count)
        side = tags[beyond.argmin(axis=1)]
        face_tags = {self.tag: np.where(mesh.face_cells[:, 1] < 0, side, 0)}
        mesh = replace(mesh, face_tags=face_tags, name=f"a plate of {mesh.n_cells} {self.drawn.family}")
        by_form: dict[str, Field] = {
            "numbers": self.left,
            "cells": kappa(mesh.cell_centroids),
            "functions": kappa,
        }
        problem = Diffusion(
            by_form[self.form],
            0.0,
            {int(tag): exact for tag in tags[~is_flux]},
            {int(tag): flux for tag in tags[is_flux]},
            boundary=self.tag,
        )
        return problem, on_levels(mesh, frozen_int(np.arange(mesh.n_cells) // 4)), exact


def smooth_plate(recipe: DrawnPlate, cells: int) -> tuple[Diffusion, Mesh, Callable[[Float], Float]]:
    """Return a problem with the solution sin(πx) sin(πy), its mesh of rectangles, and the solution."""
    mesh = replace(recipe.drawn, family="rectangles", cells=cells, grading=1.0).mesh
    low, extent = mesh.points.min(axis=0), np.ptp(mesh.points, axis=0)

    def exact(points: Float) -> Float:
        return np.asarray(np.sin(np.pi * (points - low) / extent).prod(axis=1))

    problem = Diffusion(recipe.left, times(exact, recipe.left * np.pi**2 * (1.0 / extent**2).sum()))
    return problem, mesh, exact


def boundary_tags(mesh: Mesh, name: str = Diffusion.boundary) -> list[int]:
    """Return the values of a face tag on the boundary, 0 on a mesh without the tag."""
    tags = mesh.face_tags.get(name, np.zeros(mesh.n_faces, np.int64))
    return [int(tag) for tag in np.unique(tags[mesh.outer_faces])]


def on_levels(mesh: Mesh, *levels: Int, nested: bool = True) -> Hierarchy:
    """Return the hierarchy with the given labels for each level, finest first."""
    targets = [{"n_parts": int(labels.max()) + 1} for labels in levels]
    return Hierarchy(mesh, mesh.graph, list(levels), targets, nested=nested)


def times(field: Field, factor: float) -> Field:
    """Multiply a field, such as a coefficient or source, by a factor."""
    return (lambda points: factor * field(points)) if callable(field) else factor * field


def _diffusion(mesh: Mesh, form: str) -> Diffusion:
    middle, size = mesh.points.mean(axis=0), float(np.ptp(mesh.points, axis=0).max())

    def wave(points: Float) -> Float:
        return np.asarray(1.0 + 0.8 * np.sin((points - middle).sum(axis=1) * 4.0 / size))

    rough = frozen_float(10.0 ** np.random.default_rng(3).uniform(-1.5, 1.5, mesh.n_cells))
    return {
        "numbers": Diffusion(2.0, 3.0),
        "cells": Diffusion(rough, frozen_float(wave(mesh.cell_centroids))),
        "functions": Diffusion(wave, lambda points: wave(points) - 1.0),
    }[form]


def _system(sort: str, graph: Graph, width: int, seed: int) -> Linear:
    """Return a linear system with ``width`` unknowns per cell, by name."""
    rng, n = np.random.default_rng(seed), graph.n
    shift = {"ill-conditioned": 1e-10, "singular": 0.0}.get(sort, 0.1)
    A = laplacian_of(
        graph, "even" if sort in ("even", "ill-conditioned", "singular") else "uneven", shift, seed
    )
    b, widths = rng.standard_normal(n), np.full(n, width)
    match sort:
        case "contrast":  # couplings from 1e-8 to 1e8
            exponents = rng.uniform(-4.0, 4.0, n)
            links = sparse.csr_array(10.0 ** (exponents[:, None] + exponents)) * (graph.to_scipy() != 0)
            A = sparse.diags_array(links.sum(axis=1) + 10.0 ** (exponents - 2.0)) - links
        case "units":  # of the unknowns; the residual first increases
            unit = 10.0 ** rng.uniform(-1.5, 1.5, n)
            A, b = sparse.diags_array(unit) @ A @ sparse.diags_array(unit), unit * b
        case "coupled":  # strongly and positively, also far apart
            groups = sparse.csr_array((np.ones(n), (np.arange(n), np.arange(n) % 4)), shape=(n, 4))
            A = A + 1e3 * (groups @ groups.T)
        case "nonsymmetric":
            A = A - 0.7 * sparse.tril(A, -1)
        case "slightly nonsymmetric":
            A = A + 1e-3 * sparse.triu(A, 1)
        case "triangular":
            A = sparse.tril(A)
        case "indefinite":
            A = A - 0.5 * np.median(A.diagonal()) * sparse.eye_array(n)
        case "without curvature":  # pᵀ A p = 0 for the first search directions, in parts of four cells
            A, b = (
                sparse.diags_array(np.resize([1.0, 1.0, 1.0, -1.0], n)),
                np.resize([2.0, 2.0, -1.0, -3.0], n),
            )
        case "whole numbers":
            A = sparse.csc_array(np.rint(A.toarray() + 2.0 * np.eye(n)).astype(np.int64))
        case "entries stored twice":
            A = _split_entries(sparse.csr_array(A))
        case "singular":  # b is not orthogonal to the constants
            b = b + 10.0
        case "undefined right-hand side":
            b = np.full(n, np.nan)
        case "unequal cells":
            widths = 1 + np.arange(n) % 3
    if widths.max() > 1:
        # Spread each cell's unknown over several, with random shares.
        cells = np.repeat(np.arange(n), widths)
        shares = sparse.csr_array((rng.uniform(0.3, 1.0, len(cells)), (np.arange(len(cells)), cells)))
        A, b = shares @ A @ shares.T + 20.0 * sparse.eye_array(len(cells)), np.repeat(b, widths)
    offsets = np.concatenate(([0], np.cumsum(widths)))
    return Linear(A if A.format == "csc" else sparse.csr_array(A), frozen_float(b), frozen_int(offsets))


def _split_entries(A: sparse.csr_array) -> sparse.csr_array:
    """Return an equal matrix with each entry stored as the sum of two separate entries."""
    parts = [np.split(array, A.indptr[1:-1]) for array in (A.indices, A.data)]
    indices = np.concatenate([np.concatenate([row, row[::-1]]) for row in parts[0]])
    data = np.concatenate([np.concatenate([0.25 * row, 0.75 * row[::-1]]) for row in parts[1]])
    return sparse.csr_array((data, indices, 2 * A.indptr), shape=A.shape)
