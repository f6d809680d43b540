"""Recipes for drawn test inputs: a few numbers for a mesh or graph, which a message shows as code."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass, fields, replace
from functools import lru_cache
from typing import Literal
from zlib import crc32

import numpy as np
from scipy import sparse
from scipy.sparse.csgraph import dijkstra

from agglo_core import samples
from agglo_core.arrays import Float, Int, frozen_float, frozen_int
from agglo_core.conformance.inputs import small_meshes
from agglo_core.conformance.inputs.mesh_changes import (
    beside,
    renumber_mesh,
    transform_mesh,
    without_cell,
)
from agglo_core.graph import Graph
from agglo_core.mesh import Mesh

PLANE = (
    "rectangles",
    "triangles",
    "hexagons",
    "voronoi",
    "hanging",
    "nonconvex",
    "hub",
    "ring",
    "comb",
    "strip",
)
"""Families of drawn 2-D meshes, the simplest first."""

SOLID = ("boxes", "tetrahedra", "prisms", "polyhedra", "voronoi3d")
"""Families of drawn 3-D meshes, the simplest first."""

Layout = Literal["strips", "grown", "noisy", "scattered", "alone", "rings"]
LAYOUTS: tuple[Layout, ...] = ("strips", "grown", "noisy", "scattered", "alone", "rings")
"""Layouts of labels: bands, ragged parts, these with stray cells, random or single cells, rings."""

WEIGHTS = ("measures", "ones", "steep", "uneven", "tiny", "zeros")
"""Weights of drawn graphs; uneven weights are zero for some cells."""

FACES = ("measures", "uneven", "thin", "steep", "none")
"""Interfaces of drawn graphs: as measured; times 0.1 to 10; zero for every third; falling by 1e-9; zero."""

VALUES = ("small", "negative", "large", "gmsh")
"""Tag values: 0 to 2; −1 to 1; up to 2^53; −1 and 101."""


class Recipe:
    """Base class of recipes, whose text is the code that makes the input."""

    def __repr__(self) -> str:
        given = {f.name: getattr(self, f.name) for f in fields(self)}  # type: ignore[arg-type]
        default = {f.name: f.default for f in fields(self)}  # type: ignore[arg-type]
        changed = [f"{name}={value!r}" for name, value in given.items() if value != default[name]]
        return f"{type(self).__name__}({', '.join(changed)})"


@dataclass(frozen=True, repr=False)
class DrawnMesh(Recipe):
    """Recipe for a test mesh.

    Parameters
    ----------
    family : str
        Shape of the cells, one of :data:`PLANE` or :data:`SOLID`.
    cells : int
        Number of cells, at least 1; some families make a few more or fewer.
    seed : int
        Seed of random points and displacements.
    jitter : float
        Displacement of the vertices of rectangles and boxes, relative to their spacing.
    grading : float
        Ratio of the last extent to the first along each axis, for rectangles.
    stretch : float
        Factor for the second coordinate.
    hole : bool
        Leave out the middle cell of a mesh of at least 9 cells.
    copies : int
        Number of connected components.
    turn : bool
        Rotate the mesh.
    shift, scale : float
        Shift in mesh diameters, and scale factor.
    renumbered : bool
        Renumber cells, faces and points at random.
    tags : tuple of (name, values)
        Names of tags, with one of :data:`VALUES`.
    tagged : str
        What has tags: ``"cells"``, ``"faces"`` or ``"both"``.

    Examples
    --------
    >>> from agglo_core.conformance import DrawnMesh
    >>> recipe = DrawnMesh("voronoi", cells=9, scale=1e-8)
    >>> recipe, recipe.mesh.n_cells
    (DrawnMesh(family='voronoi', cells=9, scale=1e-08), 9)
    """

    family: str = "rectangles"
    cells: int = 1
    seed: int = 0
    jitter: float = 0.0
    grading: float = 1.0
    stretch: float = 1.0
    hole: bool = False
    copies: int = 1
    turn: bool = False
    shift: float = 0.0
    scale: float = 1.0
    renumbered: bool = False
    tags: tuple[tuple[str, str], ...] = ()
    tagged: Literal["both", "cells", "faces"] = "both"

    @property
    def dim(self) -> int:
        """Dimension of space."""
        return 3 if self.family in SOLID else 2

    @property
    def mesh(self) -> Mesh:
        """The mesh, built anew at each access."""
        mesh = _family(self)
        if self.hole and mesh.n_cells >= 9:
            centres = mesh.local_centroids
            middle = np.linalg.norm(centres - centres.mean(axis=0), axis=1).argmin()
            mesh = without_cell(mesh, int(middle))
        for _ in range(self.copies - 1):
            mesh = beside(mesh, _family(replace(self, hole=False)))
        if self.stretch != 1.0:
            mesh = replace(mesh, points=mesh.points * np.array([1.0, self.stretch, 1.0][: mesh.dim]))
        mesh = transform_mesh(mesh, turned=self.turn, away=self.shift, scale=self.scale)
        if self.renumbered:
            mesh = renumber_mesh(mesh, self.seed)[0]
        of_cells = self.tags if self.tagged != "faces" else ()
        of_faces = self.tags if self.tagged != "cells" else ()
        outside = mesh.face_cells[:, 1] < 0
        cell_tags = {name: tag_values(name, values, mesh.n_cells) for name, values in of_cells}
        face_tags = {
            name: np.where(outside, tag_values(name, values, mesh.n_faces), 0) for name, values in of_faces
        }
        name = f"{mesh.n_cells} {self.family}"
        return replace(mesh, cell_tags=cell_tags, face_tags=face_tags, name=name)


def tag_values(name: str, values: str, n: int) -> Int:
    """Return ``n`` tag values of a sort in :data:`VALUES`, which differ from name to name."""
    draw = np.random.default_rng(crc32(name.encode())).integers(3, size=n)
    table = {
        "small": (0, 1, 2),
        "negative": (-1, 0, 1),
        "large": (2**53 - 1, -(2**31) - 1, 300),
        "gmsh": (-1, 101, 0),
    }
    return frozen_int(np.array(table[values], np.int64)[draw])


_RAGGED = 1.5
"""Standard deviation of the log travel time between adjacent cells."""


def grow_regions(graph: Graph, seeds: Int, rng: np.random.Generator) -> Int:
    """Grow a region from each seed at random speeds, and return the region index of each node ``(n,)``.

    Each node belongs to the seed that reaches it first (first-passage growth). The regions are ragged but
    connected.
    """
    times = rng.lognormal(0.0, _RAGGED, len(graph.indices))
    links = sparse.csr_array((times, graph.indices, graph.indptr), shape=(graph.n, graph.n))
    first: Int = dijkstra(links, indices=seeds, min_only=True, return_predecessors=True)[2]
    return frozen_int(np.searchsorted(seeds, first))


def drawn_labels(graph: Graph, layout: Layout, parts: int, seed: int = 0) -> Int:
    """Return labels 0, 1, … of at most ``parts`` parts per block of a graph, all of which occur.

    Parameters
    ----------
    graph : Graph
        Graph of one or more blocks.
    layout : str
        One of :data:`LAYOUTS`; with ``"alone"`` each cell is a part.
    parts, seed : int
        Number of parts per block, and seed of random numbers.

    Examples
    --------
    >>> from agglo_core.conformance import DrawnGraph, DrawnMesh, drawn_labels
    >>> drawn_labels(DrawnGraph(DrawnMesh(cells=4)).graph, "strips", 2).tolist()
    [0, 1, 0, 1]
    """
    rng = np.random.default_rng(seed)
    place = np.arange(graph.n) - graph.offsets[graph.block_ids]
    if layout == "alone":
        return frozen_int(place)
    counts = np.minimum(graph.sizes, parts)[graph.block_ids]  # parts in the block of each cell
    labels = np.empty(graph.n, np.int64)
    if layout in ("strips", "rings"):
        key = graph.centroids[:, np.argmax(np.ptp(graph.centroids, axis=0))]
        if layout == "rings":
            key = np.linalg.norm(graph.centroids - graph.centroids.mean(axis=0), axis=1)
        labels[np.lexsort((key, graph.block_ids))] = place * counts // graph.sizes[graph.block_ids]
        return frozen_int(labels)
    # A random cell for each part, so that all parts occur.
    shuffled = np.lexsort((rng.random(graph.n), graph.block_ids))
    first = shuffled[place < counts]
    if layout == "scattered":
        labels = rng.integers(counts)
        labels[first] = place[place < counts]
        return frozen_int(labels)
    # Grow parts from these cells; cells out of reach join part 0.
    seeds = np.sort(first)
    grown = seeds[grow_regions(graph, frozen_int(seeds), rng) % len(seeds)]
    labels[first] = place[place < counts]
    labels = np.where(graph.block_ids[grown] == graph.block_ids, labels[grown], 0)
    if layout == "noisy":
        rows = np.repeat(np.arange(graph.n), np.diff(graph.indptr))
        stray = rng.random(len(rows)) < 0.1
        kept = labels[seeds]
        labels[rows[stray]] = labels[graph.indices[stray]]
        labels[seeds] = kept
    return frozen_int(labels)


@dataclass(frozen=True, repr=False)
class DrawnGraph(Recipe):
    """Recipe for the graph of a mesh, perhaps in several blocks.

    Parameters
    ----------
    drawn : DrawnMesh
        The mesh; its cell tags are data of the graph.
    blocks : int
        Number of connected blocks to grow.
    weights : str
        One of :data:`WEIGHTS`.
    faces : str
        One of :data:`FACES`.
    barrier : bool
        Remove the edges across the middle of the mesh, except for one in four.
    gathered : bool
        Move all centroids to one point.

    Examples
    --------
    >>> from agglo_core.conformance import DrawnGraph, DrawnMesh
    >>> DrawnGraph(DrawnMesh(cells=6), blocks=2).graph.n_blocks
    2
    """

    drawn: DrawnMesh = DrawnMesh()
    blocks: int = 1
    weights: str = "measures"
    faces: str = "measures"
    barrier: bool = False
    gathered: bool = False

    @property
    def graph(self) -> Graph:
        """The graph of connected blocks, built anew at each access."""
        mesh = self.drawn.mesh
        graph: Graph = mesh.graph
        data = {name: frozen_float(tag.astype(float)) for name, tag in mesh.cell_tags.items()}
        graph = replace(graph, weights=frozen_float(_weights(graph, self.weights)), data=data)
        rows = np.repeat(np.arange(graph.n), np.diff(graph.indptr))
        if self.faces != "measures":
            graph = replace(
                graph, interface=frozen_float(graph.interface * _factors(graph, rows, self.faces))
            )
        if self.barrier:
            right = graph.centroids[:, 0] > np.median(graph.centroids[:, 0])
            across = right[rows] != right[graph.indices]
            graph = graph.without_edges(across & ((rows + graph.indices) % 4 > 0))
        if self.blocks > 1:
            labels = drawn_labels(graph, "grown", min(self.blocks, graph.n), self.drawn.seed)
            graph = graph.split(labels)[0]
        component = graph.components(graph.block_ids)
        if component.max() + 1 > graph.n_blocks:
            graph = graph.split(component)[0]
        if self.gathered:
            graph = replace(graph, centroids=frozen_float(np.zeros((graph.n, graph.dim))))
        return graph


def _weights(graph: Graph, kind: str) -> Float:
    rng, n = np.random.default_rng(graph.n), graph.n
    if kind == "uneven":
        return np.where(rng.random(n) < 0.2, 0.0, graph.measures * 10.0 ** rng.uniform(-3, 0, n))
    return {
        "measures": graph.measures,
        "ones": np.ones(n),
        "steep": 10.0 ** rng.uniform(-6, 6, n),
        "tiny": 1e-12 * rng.uniform(1, 2, n),
        "zeros": np.zeros(n),
    }[kind]


def _factors(graph: Graph, rows: Int, faces: str) -> Float:
    """Return a factor for each interface of a graph, equal for both directions of an edge."""
    if faces == "thin":
        return np.where((rows + graph.indices) % 3 == 0, 0.0, 1.0)
    if faces == "uneven":
        pair = np.minimum(rows, graph.indices) * graph.n + np.maximum(rows, graph.indices)
        return np.asarray(10.0 ** (2 * (pair * 0.618034 % 1) - 1))
    x = graph.centroids[:, 0] - graph.centroids[:, 0].min()
    steep = 10.0 ** (-4.5 * (x[rows] + x[graph.indices]) / max(x.max(), 1e-300))
    return np.asarray(steep if faces == "steep" else 0.0 * steep)


def _family(recipe: DrawnMesh) -> Mesh:
    """Return the mesh of a family, near the origin and of a size near 1 per cell."""
    return _build_family(
        DrawnMesh(recipe.family, recipe.cells, recipe.seed, jitter=recipe.jitter, grading=recipe.grading)
    )


@lru_cache(maxsize=2048)  # a law draws equal recipes for all components
def _build_family(recipe: DrawnMesh) -> Mesh:
    n, seed = recipe.cells, recipe.seed
    side, edge = max(1, round(n**0.5)), max(1, round(n ** (1 / 3)))
    rows, slices = -(-n // side), -(-n // edge**2)
    build: Mapping[str, Callable[[], Mesh]] = {
        "strip": lambda: _rectangles(n, 1, recipe),
        "rectangles": lambda: _rectangles(side, rows, recipe),
        "triangles": lambda: (
            samples.random_triangles(n // 4, seed) if n >= 4 else small_meshes.halved_squares(1, -(-n // 2))
        ),
        "hexagons": lambda: small_meshes.hexagons(side, rows),
        "voronoi": lambda: samples.voronoi(n, seed),
        "hanging": small_meshes.mixed_polygons,
        "ring": lambda: small_meshes.ring(max(n, 3)),
        "comb": small_meshes.comb,
        "hub": lambda: small_meshes.hub(max(3 * n - 1, 3)),
        "nonconvex": lambda: _grown(_rectangles(2 * side, 2 * rows, recipe), n, seed),
        "boxes": lambda: small_meshes.boxes(slices, edge, edge),
        "tetrahedra": lambda: _tetrahedra(recipe),
        "prisms": lambda: samples.prisms(max(1, n // 6), 2, seed),
        "polyhedra": lambda: _grown(small_meshes.boxes(2 * slices, 2 * edge, 2 * edge), n, seed),
        "voronoi3d": lambda: samples.voronoi3d(max(n, 2), seed),
    }
    return build[recipe.family]()


def _grown(fine: Mesh, n: int, seed: int) -> Mesh:
    """Return the mesh of at most ``n`` ragged parts of a fine mesh."""
    return fine.coarsen(drawn_labels(fine.graph, "grown", n, seed))


def _tetrahedra(recipe: DrawnMesh) -> Mesh:
    mesh = samples.tetrahedra(max(1, round((recipe.cells / 6) ** (1 / 3))))
    shifts = np.random.default_rng(recipe.seed).uniform(-0.05, 0.05, mesh.points.shape)
    return replace(mesh, points=mesh.points + shifts * recipe.jitter)


def _rectangles(nx: int, ny: int, recipe: DrawnMesh) -> Mesh:
    return small_meshes.grid(nx, ny, jitter=recipe.jitter, grading=recipe.grading, seed=recipe.seed)
