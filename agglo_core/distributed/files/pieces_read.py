"""Distributed mesh from the VTK pieces that each rank has read."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np

from agglo_core.arrays import Int, frozen_int, trusted_copy
from agglo_core.distributed.communication import Ranks
from agglo_core.distributed.mesh.distributed_mesh import DistributedMesh
from agglo_core.distributed.mesh.halo import own_cells, part_of_whole
from agglo_core.distributed.mesh.joining_ranks import join_across_ranks
from agglo_core.distributed.mesh.touching_ranks import outer_faces_touch
from agglo_core.distributed.mesh.whole_cells import WholeCells
from agglo_core.errors import FileError, MeshError
from agglo_core.io.file_checks import name_in_errors
from agglo_core.io.to_mesh.bridges import single_loops
from agglo_core.io.to_mesh.listed_faces import usual_values
from agglo_core.io.to_mesh.options import ReadOptions
from agglo_core.io.to_mesh.plain_cells import half_faces
from agglo_core.io.to_mesh.soup import Soup
from agglo_core.io.vtk.joined_pieces import in_global_order
from agglo_core.io.vtk.pieces import Stored, mesh_of_soup, soup_of_pieces
from agglo_core.mesh import Mesh
from agglo_core.mesh.elements import gather


class _Own(NamedTuple):
    """This rank's cells as a separate mesh, with global point and cell ids if known."""

    mesh: Mesh
    point_ids: Int | None
    cell_ids: Int | None


def mesh_of_pieces(stored: Stored, file: Path, ranks: Ranks, *, allow_gaps: bool) -> DistributedMesh:
    """Build a distributed mesh from the VTK pieces ``stored`` that each rank has read, possibly none.

    Raises
    ------
    FileError, MeshError
        With the file name (RankError on other ranks).
    """
    with ranks.together(), name_in_errors(file):
        own_piece = _own_cells(stored, file.stem, allow_gaps=allow_gaps)
    # Check that the pieces of all ranks fit each other.
    reports = ranks.gathered(None if own_piece is None else _facts(own_piece))
    facts = [fact for fact in reports if fact is not None]
    if not facts:
        raise MeshError(f"{file}: the mesh is empty: none of its pieces has cells")
    if len({fact.dim for fact in facts}) > 1:
        raise MeshError(f"{file}: some of its pieces are 2-D, others 3-D")
    # Join by point ids if all pieces have point ids, else by coordinates.
    tags = [name for name in facts[0].cell_tags if all(name in fact.cell_tags for fact in facts)]
    with ranks.together(), name_in_errors(file):
        usual = _common_tags(facts)
        arguments = _local_arguments(own_piece, facts, tags, usual)
    if all(fact.point_ids for fact in facts):
        return _with_usual(DistributedMesh.from_local(ranks, **arguments, allow_gaps=allow_gaps), usual)
    del arguments["point_ids"]
    mesh = DistributedMesh.from_pieces(ranks, **arguments, allow_gaps=True)
    # Insert hanging vertices, if any.
    if not allow_gaps and outer_faces_touch(_whole_own(mesh), ranks):
        mesh = _without_gaps(mesh)
    return _with_usual(mesh, usual)


def _whole_own(mesh: DistributedMesh) -> WholeCells:
    ids = mesh.global_ids, mesh.owners, mesh.point_ids, mesh.face_ids
    return own_cells(mesh.local, *ids, mesh.ranks.rank)


def _without_gaps(mesh: DistributedMesh) -> DistributedMesh:
    """Return the mesh with coincident outer faces joined across ranks."""
    ranks, whole = mesh.ranks, _whole_own(mesh)
    alone = join_across_ranks(whole, ranks, mesh.local.name)
    piece = None if alone is None else _Own(alone, None, whole.cells)
    facts = [fact for fact in ranks.gathered(None if piece is None else _facts(piece)) if fact is not None]
    with ranks.together():
        arguments = _local_arguments(piece, facts, facts[0].cell_tags, dict.fromkeys(facts[0].usual, 0))
    del arguments["point_ids"]
    return DistributedMesh.from_pieces(ranks, **arguments)


class _Facts(NamedTuple):
    """Dimension, tags and available ids of a rank's cells, shared with all ranks."""

    dim: int
    point_ids: bool
    cell_ids: bool
    cell_tags: list[str]
    usual: Mapping[str, int]


def _facts(piece: _Own) -> _Facts:
    usual = usual_values(piece.mesh)
    return _Facts(
        piece.mesh.dim,
        piece.point_ids is not None,
        piece.cell_ids is not None,
        list(piece.mesh.cell_tags),
        usual,
    )


def _own_cells(stored: Stored, name: str, *, allow_gaps: bool) -> _Own | None:
    soup, ghosts = soup_of_pieces(stored.pieces) if stored.pieces else (None, 0)
    if soup is None or not len(soup.types):
        return None
    soup = in_global_order(soup if stored.ours else soup._replace(cell_ids=None))
    merge = soup.point_ids is None
    options: ReadOptions = {"merge_points": merge, "allow_gaps": True, "drop_flat": False}
    mesh = mesh_of_soup(soup, ghosts, stored.left_out, name=name, **options)
    if not (allow_gaps or merge) and mesh.conforming(merge_points=False).n_faces != mesh.n_faces:
        raise FileError(
            "outer faces of its pieces coincide, but their points have different global "
            "ids: to keep them separate pass allow_gaps=True; to join them, read the file "
            "on rank 0 with agglo.read and distribute the mesh"
        )
    point_ids = None if soup.point_ids is None else _of_used_points(soup, mesh)
    return _Own(mesh, point_ids, soup.cell_ids)


def _of_used_points(soup: Soup, mesh: Mesh) -> Int:
    """Return the global ids of the points that cells use, in file order."""
    used = np.zeros(len(soup.points), bool)
    used[soup.vertices] = used[soup.solids.vertices] = True
    places = np.flatnonzero(used)
    if not np.array_equal(soup.points[places, : mesh.dim], mesh.points):
        raise FileError(
            "points of lines or faces differ from those of the cells, so global ids cannot be determined"
        )
    assert soup.point_ids is not None
    return frozen_int(soup.point_ids[places])


def _common_tags(facts: list[_Facts]) -> dict[str, int]:
    """Return each face tag's default value: the most common on the first rank with the tag."""
    common: dict[str, int] = {}
    for each in facts:
        common = {**each.usual, **common}
    return common


def _local_arguments(
    piece: _Own | None, facts: list[_Facts], tags: list[str], usual: Mapping[str, int]
) -> dict[str, Any]:
    """Return the arguments of :meth:`DistributedMesh.from_local` for this rank's cells."""
    if piece is None:
        return {"points": np.empty((0, 0)), "cells": [], "point_ids": []}
    mesh = piece.mesh
    offsets, vertices, loops = single_loops(mesh) if mesh.dim == 2 else (None, None, np.ones(1))
    return {
        "points": mesh.points,
        "cells": tuple(half_faces(mesh)) if mesh.dim == 3 else (offsets, vertices),
        "point_ids": piece.point_ids,
        "cell_ids": piece.cell_ids if all(fact.cell_ids for fact in facts) else None,
        "cell_tags": {name: mesh.cell_tags[name] for name in tags},
        "face_tags": {name: _list_unusual_faces(mesh, name, value) for name, value in usual.items()},
        "weak": bool((loops > 1).any()),
        "name": mesh.name,
    }


def _list_unusual_faces(mesh: Mesh, name: str, usual: int) -> tuple[tuple[Int, Int], Int]:
    """List faces whose tag differs from the usual value: their points, and the differences.

    Where no lower-dimensional cell sets the tag, its value is -1, also on ranks without such cells.
    """
    values = mesh.face_tags.get(name, frozen_int(np.full(mesh.n_faces, -1)))
    faces = frozen_int(np.flatnonzero(values != usual))
    offsets, places = gather(mesh.face_offsets, faces)
    return (offsets, frozen_int(mesh.face_vertices[places])), frozen_int(values[faces] - usual)


def _with_usual(mesh: DistributedMesh, usual: Mapping[str, int]) -> DistributedMesh:
    """Add the usual values to the face tags. Tags on faces to cells outside the local mesh stay 0."""
    local = mesh.local
    if not any(usual.values()):
        return mesh
    tags = {
        name: frozen_int(np.where(mesh.hidden, 0, values + usual[name]))
        for name, values in local.face_tags.items()
    }
    changed = part_of_whole(trusted_copy(local, face_tags=tags), local.origin, mesh.hidden)
    return replace(mesh, local=changed)
