"""Convert hierarchies to cell data and back, and compute cell data for coarse meshes."""

from __future__ import annotations

import logging
from collections.abc import Collection, Mapping, Sequence
from itertools import pairwise
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from agglo_core.arrays import (
    Float,
    Int,
    first_of_each,
    frozen_float,
    frozen_int,
    plain_array,
    trusted,
    trusted_copy,
)
from agglo_core.errors import MeshError, OptionError
from agglo_core.hierarchy import Hierarchy
from agglo_core.io.tags import is_level
from agglo_core.mesh import Mesh

LevelValues = Sequence[Mapping[str, ArrayLike]]
"""Named values on agglomerates, one mapping per level."""

_log = logging.getLogger("agglo")


def split_levels(mesh: Mesh) -> tuple[Mesh, Hierarchy | None]:
    """Remove the tags ``level_0``, ``level_1``, … from a mesh and convert them to a hierarchy, if any.

    Tags after the first missing level remain tags, and a warning is logged.
    """
    tags = dict(mesh.cell_tags)
    levels: list[Int] = []
    while f"level_{len(levels)}" in tags:
        levels.append(mesh.check_labels(tags.pop(f"level_{len(levels)}")))
    unused_names = [name for name in tags if is_level(name)]
    if unused_names:
        _log.warning("%s not read as levels: there is no level_%d", ", ".join(unused_names), len(levels))
    if not levels:
        return mesh, None
    mesh = trusted_copy(mesh, cell_tags=tags)
    nested = all(_nests(fine, coarse) for fine, coarse in pairwise(levels))
    targets = [{"parts": int(labels.max()) + 1} for labels in levels]
    return mesh, trusted(Hierarchy, mesh, mesh.graph, tuple(levels), targets, nested)


def _nests(fine: Int, coarse: Int) -> bool:
    """Return True if every part of the labelling ``fine`` lies in one part of ``coarse``."""
    return bool((coarse[first_of_each(fine)][fine] == coarse).all())


def check_belongs(mesh: Mesh, hierarchy: Hierarchy) -> None:
    """Raise MeshError if the hierarchy belongs to another mesh."""
    if hierarchy.fine is not mesh and hierarchy.fingerprint not in ("", mesh.fingerprint):
        raise MeshError(f"the hierarchy belongs to another mesh: {hierarchy.fine!r}, not {mesh!r}")
    for i, labels in enumerate(hierarchy.levels):
        if len(labels) != mesh.n_cells:
            raise MeshError(
                f"the hierarchy belongs to another mesh: level {i} has {len(labels)} labels, "
                f"but the mesh has {mesh.n_cells} cells"
            )


def coarse_cell_data(
    levels: Sequence[Int], level: int, coarse: Mesh, values: Mapping[str, Float]
) -> dict[str, NDArray[Any]]:
    """Return the cell data to be written with a coarse mesh, one value ``(k,)`` per agglomerate.

    ``agglomerate`` is the label, ``parent`` the label on the next coarser level (−1 if there is none, or if
    the agglomerate lies in several), ``cells`` the cell count; ``measure`` and ``diameter`` come from
    the coarse mesh. Other names in ``values`` follow.
    """
    labels = levels[level]
    data = {
        "agglomerate": np.arange(coarse.n_cells),
        "parent": _parents(labels, levels[level + 1 : level + 2]),
        "cells": np.bincount(labels),
        "measure": coarse.cell_measures,
        "diameter": coarse.cell_diameters,
    }
    return data | {name: array for name, array in values.items() if name not in data}


def _parents(labels: Int, coarser: Sequence[Int]) -> Int:
    first = first_of_each(labels)
    parents = np.full(len(first), -1)
    for above in coarser:
        parents = above[first]
        parents[labels[above != parents[labels]]] = -1
    return frozen_int(parents)


def check_level_values(hierarchy: Hierarchy | None, values: LevelValues) -> list[dict[str, Float]]:
    """Check user-supplied values on the agglomerates of each level and convert them to floats.

    Raises
    ------
    OptionError
        Unless there is one mapping per level, with one number per agglomerate under each name.
    """
    levels = hierarchy.levels if hierarchy is not None else []
    if len(values) != len(levels):
        raise OptionError(f"level_values: {len(values)} mappings given for {len(levels)} levels")
    for place, (mapping, labels) in enumerate(zip(values, levels, strict=True)):
        count = int(labels.max()) + 1
        for name, entry in mapping.items():
            if not isinstance(name, str) or not name or not name.isprintable():
                raise OptionError(f"level_values[{place}]: the name {name!r} must be printable text")
            array = plain_array(entry, f"level_values[{place}][{name!r}]", OptionError)
            if array.dtype.kind not in "biuf" or array.shape != (count,):
                description = f"{array.dtype} of shape {array.shape}"
                raise OptionError(
                    f"level_values[{place}][{name!r}]: expected {count} numbers, given {description}"
                )
    return [{name: frozen_float(entry) for name, entry in mapping.items()} for mapping in values]


def under_free_names(data: Mapping[str, NDArray[Any]], taken: Collection[str]) -> dict[str, NDArray[Any]]:
    """Prefix ``agglo_`` to cell data names that are already in use."""
    renamed: dict[str, NDArray[Any]] = {}
    for name, values in data.items():
        free = name
        while free in taken or free in renamed or (free != name and free in data):
            free = f"agglo_{free}"
        if free != name:
            _log.info("cell data %r are written as %r: the mesh has a tag with that name", name, free)
        renamed[free] = values
    return renamed
