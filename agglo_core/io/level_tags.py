"""Hierarchies in files that keep the labels of levels as cell data, and no targets."""

from __future__ import annotations

import logging
from itertools import pairwise

from agglo_core.arrays import Int, first_of_each, trusted, trusted_copy
from agglo_core.errors import MeshError
from agglo_core.hierarchy import Hierarchy
from agglo_core.io.tags import is_level
from agglo_core.mesh import Mesh

_log = logging.getLogger("agglo")


def split_levels(mesh: Mesh) -> tuple[Mesh, Hierarchy | None]:
    """Mesh without its tags ``level_0``, ``level_1``, …, and the hierarchy that they are, if any.

    Tags of later levels than the first that is missing stay tags, which is logged.
    """
    tags = dict(mesh.cell_tags)
    levels: list[Int] = []
    while f"level_{len(levels)}" in tags:
        levels.append(mesh.check_labels(tags.pop(f"level_{len(levels)}")))
    later = [name for name in tags if is_level(name)]
    if later:
        _log.warning("%s not taken for levels: there is no level_%d", ", ".join(later), len(levels))
    if not levels:
        return mesh, None
    mesh = trusted_copy(mesh, cell_tags=tags)
    nested = all(_nests(fine, coarse) for fine, coarse in pairwise(levels))
    targets = [{"parts": int(labels.max()) + 1} for labels in levels]
    return mesh, trusted(Hierarchy, mesh, mesh.graph, tuple(levels), targets, nested)


def _nests(fine: Int, coarse: Int) -> bool:
    """Whether every part of ``fine`` lies in one part of ``coarse``."""
    return bool((coarse[first_of_each(fine)][fine] == coarse).all())


def check_belongs(mesh: Mesh, hierarchy: Hierarchy) -> None:
    """Raise MeshError if the hierarchy was made from another mesh."""
    if hierarchy.fine is not mesh and hierarchy.fingerprint not in ("", mesh.fingerprint):
        raise MeshError(f"the hierarchy belongs to another mesh: {hierarchy.fine!r}, not {mesh!r}")
    for i, labels in enumerate(hierarchy.levels):
        if len(labels) != mesh.n_cells:
            raise MeshError(
                f"the hierarchy belongs to another mesh: level {i} has {len(labels)} labels, "
                f"the mesh {mesh.n_cells} cells"
            )
