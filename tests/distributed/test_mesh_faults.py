"""Meshes on three ranks: whatever is wrong on one of them, all of them are told, and nobody waits."""

from __future__ import annotations

import logging
from collections.abc import Callable
from dataclasses import replace
from typing import Any

import numpy as np
import pytest
from on_ranks import on_ranks

from agglo_core import Mesh, MeshError, OptionError, samples
from agglo_core.arrays import trusted
from agglo_core.distributed import DistributedMesh, RankError, Ranks

SQUARE = [[0, 0], [1, 0], [1, 1], [0, 1]]


def refused(
    ranks: Ranks, on: int | None, message: str, call: Callable[[], Any], error: Any = MeshError
) -> None:
    """All ranks refuse: with this message if ``on`` is None; else there, elsewhere naming that rank."""
    here = on in (None, ranks.rank)
    told = message if here else f"rank {on}: {error.__name__}: {message}"
    with pytest.raises(error if here else RankError, match="^" + told):
        call()
    ranks.gathered(0)  # all are here


def strip(rank: int) -> dict[str, Any]:
    """One square of a row of three, from x = rank on."""
    return {
        "points": np.add(SQUARE, [rank, 0]),
        "cells": [[0, 1, 2, 3]],
        "point_ids": np.array([0, 1, 11, 10]) + rank,
    }


def given_cells(ranks: Ranks) -> None:
    """What is wrong with cells that ranks give."""

    def on(rank: int, **changes: Any) -> Callable[[], Any]:
        mine = strip(ranks.rank) | (changes if ranks.rank == rank else {})
        return lambda: DistributedMesh.from_local(ranks, **mine)

    whole = on(-1)()
    whole.check()
    assert whole.n_cells == 3
    assert whole.global_ids.tolist() == [[0, 1], [0, 1, 2], [1, 2]][ranks.rank]
    refused(ranks, 1, "cell 0: a boundary that crosses", on(1, cells=[[0, 2, 1, 3]]))
    refused(ranks, 2, "point 1 is not finite", on(2, points=[[0, 0], [np.nan, 0], [1, 1], [0, 1]]))
    refused(ranks, 0, "cell 0 uses point 7", on(0, cells=[[0, 1, 7]]))
    refused(ranks, 1, "there are 4 points, but 3 point_ids", on(1, point_ids=[0, 1, 2]))
    refused(ranks, 1, "there are 1 cells, but 2 cell_ids", on(1, cell_ids=[0, 1]))
    refused(ranks, 0, "points 0 and 2 have the global id 5", on(0, point_ids=[5, 1, 5, 7]))
    refused(ranks, 2, "cell tag 'rock' has shape", lambda: tagged(ranks, [1] if ranks.rank < 2 else [1, 2]))
    refused(ranks, None, "rank 0 has cell tags .*rank 1 ", on(1, cell_tags={"a": [1]}))
    refused(ranks, None, "cell id 0 is given 2 times, on ranks 0, 1", on(1, cell_ids=[0]))
    refused(ranks, None, "rank 1: cell id 3, but there are 3 cells", on(1, cell_ids=[3]))
    refused(
        ranks,
        None,
        r"point 1 is at \[1.0, 0.0\] on rank 0 and at \[1.5, 0.0\] on rank 1",
        on(1, points=[[1.5, 0], [2, 0], [2, 1], [1, 1]]),
    )
    solid = samples.tetrahedra(1)
    refused(
        ranks,
        None,
        "rank 0 has a mesh in 2 dimensions, rank 2 a mesh in 3",
        on(
            2,
            points=solid.points,
            cells=[[[0, 1, 2], [0, 1, 3], [1, 2, 3], [2, 0, 3]]],
            point_ids=np.arange(len(solid.points)),
        ),
    )
    refused(ranks, None, "the mesh is empty", lambda: DistributedMesh.from_local(ranks, [], [], []))
    refused(
        ranks,
        None,
        r"a face has more than two cells: cells 0 \(rank 0\), 1 \(rank 1\), 2 \(rank 2\)",
        on(2, points=[[1, 0], [1.5, 0.5], [1, 1]], cells=[[0, 1, 2]], point_ids=[1, 30, 11]),
    )
    refused(
        ranks,
        None,
        r"cell 0 \(rank 0\) and cell 1 \(rank 1\) lie on the same side of a face",
        on(1, points=[[1, 0], [0.5, 0.5], [1, 1]], cells=[[0, 1, 2]], point_ids=[1, 30, 11]),
    )


def hanging(ranks: Ranks) -> None:
    """Faces that lie on one another without being the same: vertices in the middle of a neighbour's face."""

    def given(points: Any, cells: Any, **more: Any) -> Callable[[], DistributedMesh]:
        own = [cell for number, cell in enumerate(cells) if number % ranks.size == ranks.rank]
        ids = np.arange(len(points))
        return lambda: DistributedMesh.from_local(ranks, points, own, ids, **more)

    message = r"faces of cell \d \(rank \d\) and cell \d \(rank \d\) coincide in part but"
    plane = [*SQUARE, [2, 0], [2, 0.5], [1, 0.5], [2, 1]]
    small = [[1, 4, 5, 6], [6, 5, 7, 2]]
    refused(ranks, None, message, given(plane, [[0, 1, 2, 3], *small]))
    assert (
        given(plane, [[0, 1, 6, 2, 3], *small])().local.face_cells.min(axis=1).max() >= 0
    )  # it has that point
    apart = given(plane, [[0, 1, 2, 3], *small], allow_gaps=True)()
    assert len(apart.local.face_cells) == [4, 7, 7][ranks.rank]
    solid = [[0, 0, 0], [1, 0, 0], [0, 1, 0], [1, 1, 0], [0, 0, 1], [0, 0, -1]]
    whole = [[0, 1, 3, 2], [0, 4, 1], [1, 4, 3], [3, 4, 2], [2, 4, 0]]  # a pyramid upon two tetrahedra
    halves = [[[0, 1, 3], [0, 5, 1], [1, 5, 3], [3, 5, 0]], [[0, 3, 2], [0, 3, 5], [3, 2, 5], [2, 0, 5]]]
    refused(ranks, None, message, given(solid, [whole, *halves]))
    cut = [[0, 1, 3], [0, 3, 2], *whole[1:]]
    assert given(solid, [cut, *halves])().n_cells == 3


def touching(ranks: Ranks) -> list[str]:
    """What is said of bodies that touch, with points of their own."""
    told: list[str] = []
    handler = logging.Handler()
    handler.emit = lambda record: told.append(record.getMessage())  # type: ignore[method-assign]
    logging.getLogger("agglo").addHandler(handler)
    mine = strip(ranks.rank) | {"point_ids": np.arange(4) + 4 * ranks.rank}
    mesh = DistributedMesh.from_local(ranks, **mine)
    assert len(mesh.global_ids) == 1
    assert DistributedMesh.from_local(ranks, **mine, allow_gaps=True).n_cells == 3
    logging.getLogger("agglo").removeHandler(handler)
    return told


def tagged(ranks: Ranks, values: list[int]) -> DistributedMesh:
    return DistributedMesh.from_local(ranks, **strip(ranks.rank), cell_tags={"rock": values})


def faces(ranks: Ranks) -> None:
    """Faces deep inside what a rank has, and tags of faces."""
    inner = samples.squares(4)  # rank 2 has a triangle on an edge between two squares of rank 0
    mine: dict[str, Any] = {"points": [], "cells": [], "point_ids": []}
    if ranks.rank == 0:
        loops = inner.boundary_loops.vertices.reshape(-1, 4)
        mine = {"points": inner.points, "cells": loops, "point_ids": np.arange(inner.n_points)}
    if ranks.rank == 2:
        mine = {"points": inner.points[[6, 7, 18]], "cells": [[0, 1, 2]], "point_ids": [6, 7, 18]}
    refused(
        ranks,
        None,
        r"a face has more than two cells: cells .*16 \(rank 2\)",
        lambda: DistributedMesh.from_local(ranks, **mine),
    )

    def crossed(*values: int) -> DistributedMesh:
        listed = {"gate": ([[1, 2]] if ranks.rank == 0 else [[3, 0]], [values[ranks.rank]])}
        return DistributedMesh.from_local(
            ranks, **strip(ranks.rank), face_tags=listed if values[ranks.rank] else None
        )

    for values in ((7, 0, 0), (0, 7, 0), (7, 7, 0)):
        gate = crossed(*values)
        gate.check()
        assert gate.local.face_tags["gate"].sum() == (7 if ranks.rank < 2 else 0)
    refused(
        ranks, None, r"cell 0 \(rank 0\) and cell 1 \(rank 1\) have different tags", lambda: crossed(7, 8, 0)
    )
    diagonal = {"gate": ([[0, 2]], [1])} if ranks.rank == 1 else None
    refused(
        ranks,
        1,
        r"face tag 'gate': no cell of this rank has a face with the points \[0, 2\]",
        lambda: DistributedMesh.from_local(ranks, **strip(ranks.rank), face_tags=diagonal),
    )


def values(ranks: Ranks, mesh: DistributedMesh) -> None:
    """What is wrong with values, labels and ranks of cells."""
    own, last = mesh.global_ids[mesh.own], mesh.n_cells - 1
    extra = np.zeros(len(own) + (ranks.rank == 1))
    refused(ranks, 1, "rank 1 has .* own cells, but the values", lambda: mesh.exchange(extra))
    refused(ranks, 1, "rank 1 has .* own cells, but the values", lambda: mesh.gather(extra))
    wide = np.zeros((len(own), 2 + (ranks.rank == 2)))
    refused(
        ranks,
        None,
        r"values per cell have shape \(2,\) on rank 0, \(3,\) on rank 2",
        lambda: mesh.exchange(wide),
    )
    mixed = mesh.exchange(np.full(len(own), 0.5) if ranks.rank == 1 else np.full(len(own), 2))
    assert np.array_equal(mixed, np.where(mesh.owners == 1, 0.5, 2.0))
    bounds = [0, 2, 2, 4]
    gap = np.where(own % 4 == 1, 0, own % 4)
    refused(ranks, 0, r"labels have gaps: no cell has label 1 \(of 0..3\)", lambda: mesh.coarsen(gap, bounds))
    holder = int(mesh.gather(np.full(len(own), ranks.rank))[last])
    high = np.where(own == last, 4, own % 4)
    refused(
        ranks, holder, f"cell {last} has label 4, but there are 4 parts", lambda: mesh.coarsen(high, bounds)
    )
    refused(ranks, 2, "bounds differ", lambda: mesh.coarsen(own % 4, [0, 2, 2, 4 + (ranks.rank == 2)]))
    refused(
        ranks,
        1,
        "bounds must be 4 nondecreasing integers",
        lambda: mesh.coarsen(own % 4, bounds[ranks.rank == 1 :]),
    )
    refused(
        ranks,
        holder,
        f"cell {last} has destination rank 3, but there are 3",
        lambda: mesh.redistributed(np.where(own == last, 3, 0)),
    )
    refused(ranks, 0, "rank 0 has no mesh", lambda: DistributedMesh.scatter(None, ranks), OptionError)


def laws(ranks: Ranks, mesh: DistributedMesh) -> None:
    """Meshes that are not what they should be do not pass the check."""
    here, local, first = ranks.rank == 1, mesh.local, int(np.flatnonzero(mesh.owners != ranks.rank)[0])
    ghost = mesh.global_ids[first]

    def changed(**fields: Any) -> Callable[[], None]:
        wrong = replace(mesh, **fields) if here else mesh
        return wrong.check

    def altered(**fields: Any) -> Callable[[], None]:
        arrays = ("points", "face_offsets", "face_vertices", "face_cells", "cell_tags", "face_tags")
        return changed(local=trusted(Mesh, **({name: getattr(local, name) for name in arrays} | fields)))

    def at(array: np.ndarray, place: Any, value: Any) -> np.ndarray:
        new = array.copy()
        new[place] = value
        return new

    refused(ranks, None, "the ranks own", changed(owners=at(mesh.owners, first, 1)))
    stolen = at(at(mesh.owners, first, 1), mesh.own[0], 0)
    refused(ranks, None, "cell id .* is given 2 times", changed(owners=stolen))
    elsewhere = changed(owners=at(mesh.owners, first, 2 - mesh.owners[first]))
    refused(ranks, None, "rank .: cells .* share a face that is missing on rank", elsewhere)
    tags = {"rock": at(local.cell_tags["rock"], first, 99)}
    name = ranks.gathered(ghost)[1]
    refused(ranks, None, f"rank 1: cell {name} has a tag 'rock' that differs", altered(cell_tags=tags))
    corner = local.face_vertices[local.face_offsets[np.flatnonzero(local.face_cells[:, 0] == first)[-1]]]
    refused(
        ranks,
        None,
        "rank 1: a face of cell",
        altered(points=at(local.points, corner, local.points[corner] + 1e-9)),
    )
    refused(ranks, None, "rank 1: a face of cell", changed(hidden=~mesh.hidden))
    refused(ranks, None, "rank 1: cell .* out of order", changed(global_ids=mesh.global_ids[::-1]))


def scattered(ranks: Ranks) -> DistributedMesh:
    whole = samples.voronoi(60, seed=4).with_tags(rock=np.arange(60))
    return DistributedMesh.scatter(whole if ranks.rank == 0 else None, ranks, "curve")  # corners as below


def refuse_all() -> list[str]:
    ranks = Ranks()
    given_cells(ranks)
    hanging(ranks)
    faces(ranks)
    values(ranks, scattered(ranks))
    laws(ranks, scattered(ranks))
    return touching(ranks)


def test_faults_on_one_rank_are_raised_on_all() -> None:
    warnings = on_ranks(3, refuse_all)
    assert [len(each) for each in warnings] == [1, 0, 0]
    assert warnings[0][0].startswith(
        "outer faces, such as those of cell 0 (rank 0) and cell 1 (rank 1), coincide"
    )
