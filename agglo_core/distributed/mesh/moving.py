"""Redistribution of cells to other ranks, unchanged or merged to agglomerates."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import numpy as np
from numpy.typing import NDArray

from agglo_core.arrays import Int, frozen_int
from agglo_core.distributed.communication import Ranks
from agglo_core.distributed.mesh.whole_cells import WholeCells, merge_cells, parcels, places
from agglo_core.errors import MeshError
from agglo_core.mesh.elements import gather


def check_bounds(labels: NDArray[Any], bounds: NDArray[Any], cells: Int, ranks: Ranks) -> None:
    """Raise MeshError unless labels and offsets are valid arguments of ``DistributedMesh.coarsen``.

    Other ranks raise RankError. ``cells (n_own,)`` are global ids.
    """
    first = ranks.from_first(bounds.tolist())
    with ranks.together():
        n, kinds = ranks.size + 1, "iu"
        if bounds.shape != (n,) or bounds.dtype.kind not in kinds or bounds[0] or (np.diff(bounds) < 0).any():
            raise MeshError(
                f"bounds must be {n} nondecreasing integers starting with 0, given {bounds.tolist()}"
            )
        if first != bounds.tolist():
            raise MeshError(f"bounds differ: {first} on rank 0, {bounds.tolist()} on rank {ranks.rank}")
        _check_integers("labels", labels)
        wrong = np.flatnonzero((labels < 0) | (labels >= bounds[-1]))
        if len(wrong):
            cell, label = cells[wrong[0]], labels[wrong[0]]
            raise MeshError(f"cell {cell} has label {label}, but there are {bounds[-1]} parts")


def check_destinations(to: NDArray[Any], cells: Int, ranks: Ranks) -> None:
    """Raise MeshError unless the new rank of each cell exists (RankError on other ranks)."""
    with ranks.together():
        _check_integers("ranks", to)
        wrong = np.flatnonzero((to < 0) | (to >= ranks.size))
        if len(wrong):
            raise MeshError(
                f"cell {cells[wrong[0]]} has destination rank {to[wrong[0]]}, but there are "
                f"{ranks.size} ranks"
            )


def _check_integers(name: str, values: NDArray[Any]) -> None:
    if values.ndim != 1 or (values.size and values.dtype.kind not in "iu"):
        raise MeshError(
            f"{name} must be integers, one per own cell; given shape {values.shape}, dtype {values.dtype}"
        )


def move_cells(own: WholeCells, known: Int, number: Int, to: Int, ranks: Ranks) -> WholeCells:
    """Send cells to their new ranks, and merge cells with equal new number into one cell.

    Faces inside a joined cell vanish. A cell tag survives if constant for each number.

    Parameters
    ----------
    own : WholeCells
        Local cells before moving.
    known, number, to : (n,) int
        Global ids for own cells and ghosts (increasing), their new numbers, and their new ranks.
    """
    # Renumber cells and faces, and drop faces inside joined cells.
    sides = places(own.face_cells, known)
    numbers, new_ranks = np.append(number, -1)[sides], np.append(to, -1)[sides]
    new_faces = np.flatnonzero(numbers[:, 0] != numbers[:, 1])
    offsets, entries = gather(own.face_offsets, frozen_int(new_faces))
    at = places(own.cells, known)
    cells, first = np.unique(number[at], return_index=True)
    whole = own._replace(
        cells=frozen_int(cells),
        owners=frozen_int(to[at[first]]),
        cell_tags={name: values[first] for name, values in own.cell_tags.items()},
        faces=own.faces[new_faces],
        face_offsets=offsets,
        face_vertices=own.face_vertices[entries],
        face_cells=frozen_int(numbers[new_faces]),
        face_owners=frozen_int(new_ranks[new_faces]),
        face_tags={name: values[new_faces] for name, values in own.face_tags.items()},
    )
    # Send each cell and face to its new rank.
    face, side = np.nonzero(own.face_owners[new_faces] == ranks.rank)  # the owner of a cell sends its faces
    faces = whole.face_owners[face, side], frozen_int(face)
    sent = parcels(whole, (whole.owners, frozen_int(np.arange(len(cells)))), faces, [ranks.rank])
    arrived = list(ranks.exchanged(sent).values())
    # Keep a cell tag only if constant on each new cell, on all ranks.
    agreed = _constant_tags(number[at], own.cell_tags) & _constant_tags(
        np.concatenate([part.cells for part in arrived]),
        {name: np.concatenate([part.cell_tags[name] for part in arrived]) for name in own.cell_tags},
    )
    agreed = set.intersection(*ranks.gathered(agreed))
    result = merge_cells(arrived)
    return result._replace(
        cell_tags={name: values for name, values in result.cell_tags.items() if name in agreed}
    )


def _constant_tags(cells: Int, tags: Mapping[str, Int]) -> set[str]:
    """Return the names of tags that are constant on each group of cells with equal number."""
    _, first, cell = np.unique(cells, return_index=True, return_inverse=True)
    return {name for name, values in tags.items() if (values[first][cell] == values).all()}
