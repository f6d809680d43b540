"""Convert cell tags to the cell data of a file and back, with checks of names and values."""

from __future__ import annotations

import logging
import re
from collections.abc import Collection, Iterable, Mapping, Sequence
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from agglo_core.arrays import Int, frozen_int, trusted_copy
from agglo_core.errors import FileError, MeshError

if TYPE_CHECKING:
    from agglo_core.hierarchy import Hierarchy
    from agglo_core.mesh import Mesh

BRIDGES = "agglo_loops"
"""Internal cell data in agglo's VTU files: number of boundary loops per cell, if some cells have several."""

GHOSTS = "vtkGhostType"
"""Cell data in VTK's files that mark copies of cells in other pieces."""

_log = logging.getLogger("agglo")
_LEVEL = re.compile(r"level_\d+", re.ASCII)
_NO_XML = re.compile("[^\t\n\r\x20-\ud7ff\ue000-\ufffd\U00010000-\U0010ffff]")


def is_level(name: str) -> bool:
    """Return True if the name is reserved for the labels of a level: ``level_0``, ``level_1``, …."""
    return _LEVEL.fullmatch(name) is not None


def cell_data(mesh: Mesh, hierarchy: Hierarchy | None) -> dict[str, Int]:
    """Return the integer cell data of a file: cell tags and all level labels."""
    return tags_and_levels(mesh.cell_tags, hierarchy.levels if hierarchy is not None else None)


def tags_and_levels(tags: Mapping[str, Int], levels: Sequence[Int] | None) -> dict[str, Int]:
    """Combine tags with all level labels, and drop labels of an earlier hierarchy.

    Without levels, tags with such names are kept.
    """
    if levels is None:
        return dict(tags)
    stale = [name for name in tags if is_level(name)]
    if stale:
        _log.info("cell data of an earlier hierarchy left out: %s", ", ".join(stale))
    plain_tags = {name: values for name, values in tags.items() if not is_level(name)}
    return plain_tags | {f"level_{i}": labels for i, labels in enumerate(levels)}


def check_names(names: Iterable[str], what: str = "cell") -> None:
    """Raise MeshError if files cannot store one of these tag names."""
    for name in names:
        if not name:
            raise MeshError(f"a {what} tag has an empty name; only .npz can hold it")
        if name in (BRIDGES, GHOSTS):
            use = "cells with holes" if name == BRIDGES else "copies of other cells, which readers drop"
            raise MeshError(f"the name of {what} tag {name!r} is reserved for marking {use}")
        if _NO_XML.search(name):
            raise MeshError(f"the name of {what} tag {name!r} has control characters; only .npz can hold it")


def tag_values(name: str, values: NDArray[Any]) -> Int:
    """Convert integer values from a file to a tag.

    Raises FileError if they exceed int64.
    """
    if values.dtype.kind == "u" and values.size and values.max() > np.iinfo(np.int64).max:
        raise FileError(f"cell data {name!r} holds {values.max()}, more than an int64 can hold")
    return frozen_int(values)


def note_varying_tags(mesh: Mesh, coarse: Mesh, level: int) -> None:
    """Log the cell tags that a coarse mesh lacks, because they vary within its agglomerates."""
    lost = [name for name in mesh.cell_tags if name not in coarse.cell_tags and not is_level(name)]
    if lost:
        _log.info(
            "the mesh of level %d has no %s: values vary within agglomerates, unless regions keep them apart",
            level,
            ", ".join(lost),
        )


def note_face_tags(mesh: Mesh, suffix: str, kept: Collection[str] = ()) -> None:
    """Warn about face tags that a file cannot hold."""
    lost = [name for name in mesh.face_tags if name not in kept]
    if lost:
        _log.warning("face tags left out, which %s cannot hold: %s", suffix, ", ".join(lost))


def note_left_out(mesh: Mesh, names: Iterable[str]) -> Mesh:
    """Log the names of skipped cell data, and add their number to ``mesh.repairs``."""
    skipped_names = list(dict.fromkeys(name or "(without a name)" for name in names))
    if not skipped_names:
        return mesh
    text = "cell data that are not integers left out"
    _log.info("%s: %s", text, ", ".join(skipped_names))
    repairs: Mapping[str, int] = {**mesh.repairs, text: len(skipped_names)}
    return trusted_copy(mesh, repairs=repairs)
