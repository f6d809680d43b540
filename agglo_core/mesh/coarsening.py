"""Faces and tags of agglomerates: what remains when interior faces are dropped."""

from __future__ import annotations

from collections.abc import Mapping
from typing import NamedTuple

import numpy as np

from agglo_core.arrays import Int, first_of_each, frozen_int

__all__ = ["CoarseFaces", "coarse_faces", "surviving_tags"]


class CoarseFaces(NamedTuple):
    """Faces between agglomerates as CSR, the two agglomerates of each, and its number among all faces."""

    offsets: Int
    vertices: Int
    cells: Int
    kept: Int


def coarse_faces(labels: Int, face_offsets: Int, face_vertices: Int, face_cells: Int) -> CoarseFaces:
    """Faces that agglomerates ``labels (n_cells,)`` keep.

    Parameters
    ----------
    labels : (n_cells,) int
        Agglomerate of each cell.
    face_offsets, face_vertices, face_cells
        As in :class:`~agglo_core.mesh.Mesh`.
    """
    coarse = np.append(labels, -1)[face_cells]
    kept = np.flatnonzero(coarse[:, 0] != coarse[:, 1])
    sizes = np.diff(face_offsets)[kept]
    offsets = np.concatenate(([0], np.cumsum(sizes)))
    vertices = np.arange(offsets[-1]) + np.repeat(face_offsets[kept] - offsets[:-1], sizes)
    return CoarseFaces(
        frozen_int(offsets), frozen_int(face_vertices[vertices]), frozen_int(coarse[kept]), frozen_int(kept)
    )


def surviving_tags(tags: Mapping[str, Int], labels: Int) -> dict[str, Int]:
    """Cell tags that are constant on every agglomerate, by agglomerate."""
    first = first_of_each(labels)
    return {name: values[first] for name, values in tags.items() if (values[first][labels] == values).all()}
