"""What files of coarse meshes say about each agglomerate, beside its tags."""

from __future__ import annotations

import logging
from collections.abc import Collection, Mapping, Sequence
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from agglo_core.arrays import Float, Int, first_of_each, frozen_float, frozen_int, plain_array
from agglo_core.errors import OptionError
from agglo_core.hierarchy import Hierarchy
from agglo_core.mesh import Mesh

LevelValues = Sequence[Mapping[str, ArrayLike]]

_log = logging.getLogger("agglo")


def about_agglomerates(
    levels: Sequence[Int], level: int, coarse: Mesh, values: Mapping[str, Float]
) -> dict[str, NDArray[Any]]:
    """Cell data of the coarse mesh of one of the levels, each ``(k,)``.

    ``agglomerate`` is the label, ``parent`` that of the agglomerate of the next coarser level that holds it
    (−1 if there is no such level, or it lies in several), ``cells`` the number of cells, ``measure`` and
    ``diameter`` are those of the coarse mesh. ``values`` of other names follow.
    """
    labels = levels[level]
    known = {
        "agglomerate": np.arange(coarse.n_cells),
        "parent": _parents(labels, levels[level + 1 : level + 2]),
        "cells": np.bincount(labels),
        "measure": coarse.cell_measures,
        "diameter": coarse.cell_diameters,
    }
    return known | {name: each for name, each in values.items() if name not in known}


def _parents(labels: Int, coarser: Sequence[Int]) -> Int:
    first = first_of_each(labels)
    parents = np.full(len(first), -1)
    for above in coarser:
        parents = above[first]
        parents[labels[above != parents[labels]]] = -1
    return frozen_int(parents)


def check_level_values(hierarchy: Hierarchy | None, values: LevelValues) -> list[dict[str, Float]]:
    """The values of each level as reals.

    Raises
    ------
    OptionError
        Unless there is one mapping for each level, and in it by name one number for each agglomerate.
    """
    levels = hierarchy.levels if hierarchy is not None else []
    if len(values) != len(levels):
        raise OptionError(f"level_values: {len(values)} mappings given for {len(levels)} levels")
    for place, (given, labels) in enumerate(zip(values, levels, strict=True)):
        count = int(labels.max()) + 1
        for name, each in given.items():
            if not isinstance(name, str) or not name or not name.isprintable():
                raise OptionError(f"level_values[{place}]: {name!r} is no name: it must be text to be shown")
            array = plain_array(each, f"level_values[{place}][{name!r}]", OptionError)
            if array.dtype.kind not in "biuf" or array.shape != (count,):
                found = f"{array.dtype} of shape {array.shape}"
                raise OptionError(f"level_values[{place}][{name!r}]: {found}; expected {count} numbers")
    return [{name: frozen_float(each) for name, each in given.items()} for given in values]


def under_free_names(data: Mapping[str, NDArray[Any]], taken: Collection[str]) -> dict[str, NDArray[Any]]:
    """The data; a name that a tag of the user has, or a mark of our own, gets ``agglo_`` before it."""
    renamed: dict[str, NDArray[Any]] = {}
    for name, values in data.items():
        free = name
        while free in taken or free in renamed or (free != name and free in data):
            free = f"agglo_{free}"
        if free != name:
            _log.info("cell data %r are written as %r: the mesh has a tag of that name", name, free)
        renamed[free] = values
    return renamed
