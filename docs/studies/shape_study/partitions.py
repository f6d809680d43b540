"""Partitions of a mesh in equally many parts, from excellent to bad: usual methods, and random ones."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, field
from itertools import chain, count, islice, zip_longest
from types import MappingProxyType
from typing import Any, Final

import numpy as np
from scipy.sparse import csr_matrix
from scipy.sparse.csgraph import dijkstra
from scipy.spatial import cKDTree

from agglo_core.authoring import (
    Graph,
    InertialBisection,
    Int,
    Mesh,
    PluginError,
    Target,
    UInt64,
    agglomerate,
    default,
    frozen_int,
)


class _Partitioner:
    """Base of partitioners; missing parts are made by bisections across principal axes."""

    def bisect_level(self, level: Graph, seeds: UInt64) -> Int:
        """Side of each node ``(n,)``."""
        return InertialBisection().bisect_level(level, seeds)


class Scattered(_Partitioner):
    """Cells go to the nearest of random points, which then move to the centroids of what they have.

    Parameters
    ----------
    steps : int
        How often they move; 0 leaves a random Voronoi partition.
    stretch : float
        By which one axis, in a random direction, is scaled before: parts become as long.
    grading : float
        Weights grow as its exponential along a random direction: parts become smaller there.
    """

    def __init__(self, steps: int = 0, stretch: float = 1.0, grading: float = 0.0) -> None:
        self.steps, self.stretch, self.grading = steps, stretch, grading

    def partition(self, graph: Graph, target: Target, seed: int) -> Int:
        """Labels ``(n,)``, some of which may be left unused."""
        rng, points = np.random.default_rng(seed), graph.centroids
        k = min(target.parts or 1, graph.n)
        axes = np.linalg.qr(rng.normal(size=(graph.dim, graph.dim)))[0]
        points = points @ axes
        place = (points[:, 0] - points[:, 0].min()) / (np.ptp(points[:, 0]) or 1.0)
        weights = graph.measures * np.exp(self.grading * place)
        points = points * np.append(self.stretch, np.ones(graph.dim - 1))
        means = points[rng.choice(graph.n, k, replace=False)]
        for _ in range(self.steps):
            labels = cKDTree(means).query(points)[1]
            total = np.bincount(labels, weights, k)
            sums = np.stack([np.bincount(labels, weights * x, k) for x in points.T], axis=1)
            means = np.where(total[:, None] > 0, sums / np.where(total > 0, total, 1.0)[:, None], means)
        return frozen_int(cKDTree(means).query(points)[1])


class Growth(_Partitioner):
    """Parts grow from random cells, all at the same time, over edges that take a random time.

    Parameters
    ----------
    roughness : float
        Power of exponentially distributed times: 0 goes breadth first, 1 is Eden's growth, more than that
        leaves branches.
    """

    def __init__(self, roughness: float = 0.0) -> None:
        self.roughness = roughness

    def partition(self, graph: Graph, target: Target, seed: int) -> Int:
        """Labels ``(n,)`` of connected parts."""
        rng = np.random.default_rng(seed)
        starts = rng.choice(graph.n, min(target.parts or 1, graph.n), replace=False)
        times = rng.exponential(size=len(graph.indices)) ** self.roughness + 1e-9
        roads = csr_matrix((times, graph.indices, graph.indptr), shape=(graph.n, graph.n))
        _, _, sources = dijkstra(roads, indices=starts, min_only=True, return_predecessors=True)
        place = np.zeros(graph.n, np.int64)
        place[starts] = np.arange(len(starts))
        return frozen_int(place[sources])


class Shaken(_Partitioner):
    """A good partition, of whose boundary cells some go to the part of a neighbour, again and again.

    Parameters
    ----------
    rounds : int
    share : float
        Of the boundary cells, in a round.
    """

    def __init__(self, rounds: int = 1, share: float = 0.3) -> None:
        self.rounds, self.share = rounds, share

    def partition(self, graph: Graph, target: Target, seed: int) -> Int:
        """Labels ``(n,)`` of parts that need not be connected any more."""
        rng = np.random.default_rng(seed)
        labels = agglomerate(graph, n_parts=target.parts).levels[0].copy()
        cells = np.repeat(np.arange(graph.n), np.diff(graph.indptr))
        for _ in range(self.rounds):
            edges = np.flatnonzero(labels[cells] != labels[graph.indices])
            moved = rng.permutation(edges)[: int(self.share * len(edges) / 2)]
            labels[cells[moved]] = labels[graph.indices[moved]]
        return frozen_int(np.unique(labels, return_inverse=True)[1])


@dataclass(frozen=True)
class Recipe:
    """A way to make a partition.

    Attributes
    ----------
    name : str
    options : mapping
        Of ``agglomerate``, besides number of parts and seed.
    usual : bool
        Whether anybody would use it.
    seeded : bool
        Whether another seed gives another partition.
    """

    name: str
    options: Mapping[str, Any] = field(default_factory=dict)
    usual: bool = True
    seeded: bool = False

    @property
    def problem(self) -> str:
        """Why it cannot be used here."""
        bisector = self.options.get("bisector", "kmeans")
        name = bisector[0] if isinstance(bisector, tuple) else bisector
        if not isinstance(name, str):
            return ""
        try:
            record = default().record("bisector", name)
        except PluginError as error:
            return str(error)
        return "" if record.state == "ok" else record.reason

    def labels(self, mesh: Mesh, parts: int, seed: int) -> Int:
        """Part of each cell ``(n_cells,)``: exactly ``parts`` connected ones."""
        return self.levels(mesh, {"n_parts": parts}, seed)[0]

    def levels(self, mesh: Mesh, target: Mapping[str, Any], seed: int) -> Sequence[Int]:
        """Nested levels of connected parts, finest first, by ``n_parts`` or ``h_star``."""
        return agglomerate(mesh, seed=seed, **target, **self.options).levels


_BARE: Final = MappingProxyType({"refiners": (), "polish": False})
_KWAY: Final = MappingProxyType({"method": "kway", **_BARE})


def _random(name: str, bisector: _Partitioner) -> Recipe:
    return Recipe(name, {"bisector": bisector, **_KWAY}, usual=False, seeded=True)


_USUAL: Final = (
    Recipe("kmeans"),
    Recipe("METIS k-way", {"bisector": ("metis", {}), **_KWAY}, seeded=True),
    Recipe("kmeans, neither refined nor polished", dict(_BARE)),
    Recipe("coordinate, neither refined nor polished", {"bisector": "coordinate", **_BARE}),
    Recipe("kmeans k-way", {"method": "kway"}),
    Recipe("METIS k-way, balanced", {"bisector": ("metis", {"ufactor": 30}), **_KWAY}, seeded=True),
    Recipe("spectral", {"bisector": "spectral"}),
    Recipe("METIS recursive", {"bisector": ("metis", {"algorithm": "recursive"}), **_KWAY}, seeded=True),
    Recipe("sweep", {"bisector": "sweep"}),
    Recipe("inertial", {"bisector": "inertial", "polish": False}),
    Recipe("gnn", {"bisector": "gnn"}),
    Recipe("METIS k-way, polished", {"bisector": ("metis", {}), "method": "kway"}, seeded=True),
    Recipe("kmeans, not polished", {"polish": False}),
)
_RANDOM: Final = (
    _random("random growth", Growth(1.0)),
    _random("random points", Scattered()),
    _random("shaken", Shaken(1)),
    _random("stretched by 2", Scattered(20, stretch=2.0)),
    _random("random points, 3 steps", Scattered(3)),
    _random("breadth first", Growth(0.0)),
    _random("branches", Growth(3.0)),
    _random("graded", Scattered(20, grading=3.0)),
    _random("shaken 4 times", Shaken(4)),
    _random("stretched by 4", Scattered(20, stretch=4.0)),
    _random("random points, 20 steps", Scattered(20)),
    _random("shaken 12 times", Shaken(12)),
)
_ANNEALED: Final = Recipe(
    "kmeans k-way, annealed",
    {"bisector": ("kmeans", {"effort": "good", "objective": "roundness"}), "method": "kway"},
    seeded=True,
)
RECIPES: Final = MappingProxyType({each.name: each for each in (*_USUAL, *_RANDOM, _ANNEALED)})
"""All recipes by name."""


def chosen(number: int, annealed: bool = False) -> list[tuple[str, int]]:
    """So many names of recipes that can be used here, each with a seed: usual and random ones by turns.

    First all with seed 0, then those that hang on the seed with 1, 2, … ``annealed``: with annealed parts.
    """
    first_ones = (_USUAL[0], _ANNEALED, *_USUAL[1:]) if annealed else _USUAL
    usual, others = ([each for each in all_ if not each.problem] for all_ in (first_ones, _RANDOM))
    first = [each for pair in zip_longest(usual, others) for each in pair if each is not None]
    again = [each for each in first if each.seeded]

    def later() -> Iterator[tuple[str, int]]:
        for seed in count(1):
            yield from ((each.name, seed) for each in again)

    return list(islice(chain(((each.name, 0) for each in first), later()), number))
