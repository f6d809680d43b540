"""Cells given by the user on each rank, checked across ranks and built as a mesh in global order."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from functools import partial
from itertools import pairwise
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import ArrayLike

from agglo_core.arrays import Float, Int, frozen_float, frozen_int, trusted
from agglo_core.distributed.communication import Ranks
from agglo_core.distributed.mesh.shared import check_ids, number_by_place
from agglo_core.errors import MeshError
from agglo_core.mesh import Mesh
from agglo_core.mesh.checks import (
    check_finite,
    check_indices,
    check_offsets,
    check_points,
    check_tags,
    whole_numbers,
)
from agglo_core.mesh.construction.polygons import loops_as_csr
from agglo_core.mesh.construction.polyhedra import solids_as_csr
from agglo_core.mesh.elements import Polyhedra, gather, take_cells


class GivenCells(NamedTuple):
    """One rank's cells as a mesh, with cells and points by increasing global id."""

    mesh: Mesh
    cells: Int  # global ids
    points: Int  # global ids
    numbers: Int  # (n_given_points,) mesh number of each given point, -1 if unused


class _Lists(NamedTuple):
    """Given cells as CSR lists: vertices of polygons, or faces of polyhedra with their vertices."""

    points: Float
    point_ids: Int
    offsets: tuple[Int, ...]
    vertices: Int

    @property
    def n_cells(self) -> int:
        return len(self.offsets[0]) - 1

    @property
    def dim(self) -> int:
        return int(self.points.shape[1])

    def ordered(self, order: Int) -> _Lists:
        """Return the cells in the given order."""
        if self.dim == 3:
            solids = Polyhedra(self.offsets[0], self.offsets[1], self.vertices)
            cells, loops, vertices = take_cells(solids, order)
            return self._replace(offsets=(cells, loops), vertices=vertices)
        offsets, places = gather(self.offsets[0], order)
        return self._replace(offsets=(offsets,), vertices=self.vertices[places])

    def mesh(self, tags: Mapping[str, Int], name: str, *, weak: bool) -> Mesh:
        """Build the cells as a mesh, regardless of other ranks."""
        if not self.n_cells:
            nothing = frozen_int([0]), frozen_int([]), np.empty((0, 2), np.int64)
            return trusted(Mesh, self.points, *nothing, tags)
        build: Callable[..., Mesh] = (
            Mesh.from_polyhedra if self.dim == 3 else partial(Mesh.from_polygons, weak=weak)
        )
        cells = (*self.offsets, self.vertices)
        return build(self.points, cells, cell_tags=tags, merge_points=False, allow_gaps=True, name=name)


def check_given_cells(
    points: ArrayLike,
    cells: Any,
    point_ids: ArrayLike | None,
    cell_ids: ArrayLike | None,
    cell_tags: Mapping[str, ArrayLike] | None,
    ranks: Ranks,
    *,
    weak: bool,
    name: str,
) -> GivenCells:
    """Check the given cells across ranks, and build this rank's mesh.

    Arguments and errors are those of :meth:`DistributedMesh.from_local`. Without ``point_ids`` on all
    ranks, points with exactly equal coordinates are identified.
    """
    # Dimension and tag names must agree on all ranks with cells.
    with ranks.together():
        lists = _check_lists(points, cells, point_ids)
    dim = _require_agreement(
        [each or None for each in ranks.gathered(lists.dim)], "a mesh in {} dimensions", ranks
    )
    if not lists.n_cells:
        lists = lists._replace(points=np.empty((0, dim)), offsets=(frozen_int([0]),) * (dim - 1))
    if point_ids is None:
        lists = lists._replace(point_ids=number_by_place(lists.points, ranks))
    counts = ranks.gathered(lists.n_cells)
    tagged = ranks.gathered(sorted(cell_tags or {}) if lists.n_cells else None)
    names = _require_agreement(tagged, "cell tags {}", ranks)
    # Cell ids must be a permutation of 0..n_cells−1 over all ranks.
    with ranks.together():
        ids = _ids(cell_ids, counts, ranks.rank)
        tags = check_tags(
            "cell", cell_tags or {} if lists.n_cells else dict.fromkeys(names, ids), lists.n_cells
        )
    check_ids(ids, sum(counts), ranks)
    # Build the mesh in global order.
    order = frozen_int(np.argsort(ids, kind="stable"))
    tags = {key: values[order] for key, values in tags.items()}
    with ranks.together():
        distinct, used_ids, numbers = _distinct(lists)
        try:
            mesh = distinct.ordered(order).mesh(tags, name, weak=weak)
        except MeshError:
            # probably fails equally, but with an error in the caller's numbers
            lists.mesh({}, name, weak=weak)
            raise
    return GivenCells(mesh, ids[order], used_ids, numbers)


def _check_lists(points: ArrayLike, cells: Any, point_ids: ArrayLike | None) -> _Lists:
    if not len(cells) or (isinstance(cells, tuple) and len(cells[0]) < 2):
        return _Lists(np.empty((0, 0)), frozen_int([]), (frozen_int([0]),), frozen_int([]))
    coordinates = check_points(points)
    ids = whole_numbers(np.arange(len(coordinates)) if point_ids is None else point_ids, "point_ids")
    if len(ids) != len(coordinates):
        raise MeshError(f"there are {len(coordinates)} points, but {len(ids)} point_ids")
    *offsets, vertices = (solids_as_csr if coordinates.shape[1] == 3 else loops_as_csr)(cells)
    for array, entries in pairwise([*offsets, vertices]):
        check_offsets(array, len(entries) - (entries is not vertices), "cell")
    first = offsets[0] if len(offsets) == 1 else offsets[1][offsets[0]]
    check_indices(first, vertices, len(coordinates))
    check_finite(coordinates, vertices)
    return _Lists(coordinates, ids, tuple(offsets), vertices)


def _require_agreement(values: list[Any], template: str, ranks: Ranks) -> Any:
    """Return the value common to all ranks with cells, or raise MeshError on all ranks if they differ."""
    answers = [(rank, value) for rank, value in enumerate(values) if value is not None]
    if not answers:
        raise MeshError("the mesh is empty: no rank has a cell")
    (first, first_value), *others = answers
    for rank, value in others:
        if value != first_value:
            raise MeshError(
                f"rank {first} has {template.format(first_value)}, rank {rank} {template.format(value)}"
            )
    return first_value


def _ids(cell_ids: ArrayLike | None, counts: list[int], rank: int) -> Int:
    """Return the global ids of this rank's cells, by default numbered rank after rank."""
    if cell_ids is None:
        return frozen_int(np.arange(counts[rank]) + sum(counts[:rank]))
    ids = whole_numbers(cell_ids, "cell_ids")
    if len(ids) != counts[rank]:
        raise MeshError(f"there are {counts[rank]} cells, but {len(ids)} cell_ids")
    return ids


def _distinct(lists: _Lists) -> tuple[_Lists, Int, Int]:
    """Merge points with equal global id, and drop unused points.

    Return the cells, the global point ids, and the new index per given point.
    """
    is_used = np.zeros(len(lists.points), bool)
    is_used[lists.vertices] = True
    rows = np.flatnonzero(is_used)
    used_ids, first, number = np.unique(lists.point_ids[rows], return_index=True, return_inverse=True)
    points = lists.points[rows[first]]
    wrong = np.flatnonzero((lists.points[rows] != points[number]).any(axis=1))
    if len(wrong):
        a, b = rows[first[number[wrong[0]]]], rows[wrong[0]]
        raise MeshError(
            f"points {a} and {b} have the global id {lists.point_ids[a]}, but are at different "
            f"places: {lists.points[a].tolist()} and {lists.points[b].tolist()}"
        )
    numbers = np.full(len(lists.points), -1)
    numbers[rows] = number
    vertices = frozen_int(numbers[lists.vertices])
    distinct = lists._replace(points=frozen_float(points), point_ids=frozen_int(used_ids), vertices=vertices)
    return distinct, frozen_int(used_ids), frozen_int(numbers)
