"""Writer for distributed meshes and hierarchies: one VTK piece per rank and a list of the pieces."""

from __future__ import annotations

import logging
import re
from collections.abc import Mapping
from os import PathLike
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from agglo_core.arrays import Int, frozen_int
from agglo_core.distributed.files.own_pieces import remove_pieces, write_pieces
from agglo_core.distributed.files.shared_staging import shared_staging
from agglo_core.distributed.mesh.distributed_mesh import DistributedMesh
from agglo_core.errors import FileError, MeshError, OptionError
from agglo_core.io.atomic import check_replaceable
from agglo_core.io.file_checks import name_in_errors
from agglo_core.io.levels import under_free_names
from agglo_core.io.tags import BRIDGES, check_names, is_level, tags_and_levels
from agglo_core.io.vtk.pvtu import PIECES

if TYPE_CHECKING:
    from agglo_core.distributed.agglomeration.hierarchy import DistributedHierarchy

_log = logging.getLogger("agglo")


def write(
    path: str | PathLike[str],
    mesh: DistributedMesh,
    hierarchy: DistributedHierarchy | None = None,
    *,
    compress: bool = False,
) -> None:
    """Write a distributed mesh, and optionally its hierarchy, as ``.pvtu``. Collective.

    Each rank writes its own cells to ``NAME/NAME_<rank>.vtu``, rank 0 the list ``NAME.pvtu`` for ParaView.
    Cells carry their tags, all levels' labels as ``level_0``, … and global ids, so that
    :func:`agglo_core.read` restores the mesh before its distribution. With a hierarchy, each coarse mesh is
    written as ``NAME_level0.pvtu``, …, with label, parent, cell count, measure and diameter of each
    agglomerate. Files appear whole or not at all, the lists last.

    Parameters
    ----------
    path : path
        Equal on all ranks, in a shared folder.
    mesh : DistributedMesh
    hierarchy : DistributedHierarchy, optional
        Hierarchy on this mesh.
    compress : bool
        Write smaller files, at the cost of slower writing and reading.

    Raises
    ------
    FileError
        If a file cannot be written. A failure on one rank is a failure on all ranks, with a RankError on
        the others.
    MeshError
        If the hierarchy belongs to another mesh, or a cell tag has a name that files cannot hold.

    Examples
    --------
    >>> from agglo_core import distributed, read, samples
    >>> mesh = distributed.DistributedMesh.scatter(samples.squares(4))
    >>> distributed.write("squares.pvtu", mesh)
    >>> read("squares.pvtu").n_cells
    16
    """
    ranks = mesh.ranks
    # Check all arguments before writing.
    with ranks.together():
        target = Path(path)
        check_parallel_target(target)
        if hierarchy is not None and hierarchy.mesh is not mesh:
            raise MeshError(f"the hierarchy belongs to another mesh: {hierarchy.mesh!r}, not {mesh!r}")
        levels = hierarchy.levels if hierarchy is not None else None
        own_tags = {name: frozen_int(values[mesh.own]) for name, values in mesh.local.cell_tags.items()}
        tags = tags_and_levels(own_tags, levels)
        check_names(tags)
        check_names(mesh.local.face_tags, "face")
    with shared_staging(target, ranks) as folder:
        write_pieces(folder, target.stem, mesh, tags, {}, compress=compress)
        for level in range(len(levels) if levels is not None else 0):
            assert hierarchy is not None
            stem = f"{target.stem}_level{level}"
            coarse, part_tags, part_data = _coarse(hierarchy, level, {BRIDGES, *filter(_no_level, own_tags)})
            write_pieces(folder, stem, coarse, part_tags, part_data, compress=compress)
    with ranks.together():
        if ranks.rank == 0:
            _remove_stale(target, ranks.size, None if levels is None else len(levels))


def check_parallel_target(target: Path) -> None:
    """Raise OptionError or FileError unless ``target`` is a ``.pvtu`` file that can be written."""
    if target.suffix.lower() != ".pvtu":
        raise OptionError(
            f"{target}: distributed meshes and solutions are written as .pvtu, given {target.suffix!r}; to "
            "convert a mesh use one process: "
            f"agglo.write({target.name!r}, *agglo.read_hierarchy('NAME.pvtu'))"
        )
    if target.is_dir():
        raise FileError(f"{target} is a folder, expected a file name")
    if not target.parent.is_dir():
        raise FileError(f"{target}: the folder {target.parent} does not exist")
    with name_in_errors(target):
        check_replaceable(target)


def _no_level(name: str) -> bool:
    return not is_level(name)


def _coarse(
    hierarchy: DistributedHierarchy, level: int, used_names: set[str]
) -> tuple[DistributedMesh, Mapping[str, Int], Mapping[str, NDArray[Any]]]:
    """Return the coarse mesh of a level, with tags and data of the agglomerates on this rank."""
    coarse = hierarchy.mesh_of(level)
    counts = _cells_of_parts(hierarchy, level)
    parents = np.full(len(coarse.own), -1)
    if hierarchy.nested and level + 1 < len(hierarchy.levels):
        parents = np.asarray(hierarchy.parents(level))
    with coarse.ranks.together():
        local, places = coarse.local, coarse.own
        data: dict[str, NDArray[Any]] = {
            "agglomerate": coarse.global_ids[places],
            "parent": parents,
            "cells": counts,
            "measure": local.cell_measures[places],
            "diameter": local.cell_diameters[places],
        }
        tags = {name: frozen_int(tag[places]) for name, tag in local.cell_tags.items() if not is_level(name)}
        return coarse, tags, under_free_names(data, used_names)


def _cells_of_parts(hierarchy: DistributedHierarchy, level: int) -> Int:
    """Return the cell count per agglomerate of this rank, counted on all ranks."""
    ranks, bounds = hierarchy.mesh.ranks, hierarchy.bounds[level]
    parts, cells = np.unique(hierarchy.levels[level], return_counts=True)
    owners = np.searchsorted(bounds, parts, side="right") - 1
    parcels = {int(r): np.stack((parts[owners == r], cells[owners == r])) for r in np.unique(owners)}
    counts = np.zeros(bounds[ranks.rank + 1] - bounds[ranks.rank], np.int64)
    for part_ids, numbers in ranks.exchanged(parcels).values():
        counts[part_ids - bounds[ranks.rank]] += numbers
    return frozen_int(counts)


def _remove_stale(target: Path, size: int, levels: int | None) -> None:
    """Remove files of an earlier run that had more ranks or more levels."""
    stem = re.escape(target.stem)
    for file in sorted(target.parent.glob("*.pvtu")):
        match = re.fullmatch(stem + r"(?:_level(0|[1-9]\d*))?\.pvtu", file.name, re.ASCII)
        if match is None:
            continue
        is_stale = match[1] is not None and levels is not None and levels <= int(match[1])
        is_current = match[1] is None or (levels is not None and not is_stale)
        try:
            if is_stale and file.read_bytes()[: len(PIECES)] == PIECES:
                file.unlink()
                _log.info("removed %s, a level of an earlier hierarchy", file)
            if is_stale or is_current:
                remove_pieces(target.parent / file.stem, 0 if is_stale else size)
        except OSError as error:  # the mesh and its levels are complete, so only warn
            _log.warning("cannot remove old files of %s: %s", file, error.strerror)
