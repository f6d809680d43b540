"""Levels in any of the forms that callers have them in: ready, a hierarchy, labels."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

from numpy.typing import ArrayLike

from agglo_core.authoring import Hierarchy, Int, Patches, frozen_int, multigrid
from agglo_petsc.levels.aggregates import PetscLevels, aggregate_levels
from agglo_petsc.levels.labels import nested_aggregates
from agglo_petsc.matrices import agree

Levels = PetscLevels | Hierarchy | Sequence[ArrayLike]

_ADVICE = "(shared unknowns get labels by labels_of_unknowns; mat.setBlockSize says how many a cell has)"


def levels_for(A: Any, given: Levels) -> PetscLevels:
    """The levels of a matrix; a hierarchy, or labels, are those of the parts of this rank. Collective.

    Raises
    ------
    OptionError
        On all ranks, if they do not fit the matrix.
    """
    if isinstance(given, PetscLevels):
        return given
    comm, width = A.getComm(), A.getBlockSize()
    parts = A.getLocalSize()[0] // width
    labels = [frozen_int(each) for each in (given.levels if isinstance(given, Hierarchy) else given)]
    wrong = next((f"labels have the shape {each.shape}" for each in labels if each.shape != (parts,)), "")
    agree(comm, wrong and f"{wrong}; the matrix has {parts} parts of {width} unknowns here {_ADVICE}")
    ups = nested_aggregates(labels)
    counts = [parts, *(int(each.max(initial=-1)) + 1 for each in ups)]
    before = [sum(each) for each in zip(*comm.tompi4py().allgather(counts)[: comm.getRank()], strict=True)]
    first = before or [0] * len(counts)
    numbered = [frozen_int(up + start) for up, start in zip(ups, first[1:], strict=True)]
    return aggregate_levels(A, numbered, patches=_patches(given, labels, first))


def _patches(given: Any, labels: list[Int], first: list[int]) -> list[Patches | None] | None:
    """Vertex patches in the plane, if there is a mesh; numbers start from the first part of this rank."""
    mesh = given.fine if isinstance(given, Hierarchy) else None
    if mesh is None or mesh.dim != 2:
        return None
    found: list[Patches | None] = []
    for finer, start in zip([None, *labels[:-1]], first[:-1], strict=True):
        own = multigrid.vertex_patches(mesh, finer)
        found.append(Patches(own.offsets, frozen_int(own.parts + start)))
    return found
