"""Find faces whose penalty is large or small relative to the other faces of their cells."""

from __future__ import annotations

import numpy as np

from agglo_core.authoring import Float, Int, Mesh, frozen_float, frozen_int

_STRONG = 3.0
"""A face is strong if its penalty exceeds this multiple of the smallest in either cell: many strong faces
make a mesh bad (benchmarks/solve.py --meshes random graded layers)."""
_JOINED = 2.0
"""Cells are smoothed together if the penalty between them exceeds this multiple of the smallest in either
cell. A smaller value makes more groups (benchmarks/solve.py --meshes graded layers --degrees 1)."""
_WEAK = 0.1
"""A face is weak if a jump costs less than this multiple of the maximum in both cells: many weak faces are
layers of flat cells (benchmarks/solve.py --meshes graded layers)."""


def strong_pairs(mesh: Mesh, sigma: Float) -> Int:
    """Return the cell pairs ``(m, 2)`` that share a face with large penalty, strongest first.

    Large means more than twice the smallest penalty on the faces of the two cells.

    Parameters
    ----------
    mesh : Mesh
    sigma : (n_faces,) float
        Penalty in 1 / length; 0 on natural faces.
    """
    strength = _strength(mesh, sigma)
    strong = np.flatnonzero(strength > _JOINED)
    strong = strong[np.argsort(-strength[strong], kind="stable")]
    return frozen_int(mesh.face_cells[mesh.face_cells[:, 1] >= 0][strong])


def strong_part(mesh: Mesh, sigma: Float) -> float:
    """Return the fraction of inner faces with a large penalty.

    Their penalty is more than 3 times the smallest penalty in one of their cells.
    """
    strength = _strength(mesh, sigma)
    return float(np.mean(strength > _STRONG)) if len(strength) else 0.0


def weak_part(mesh: Mesh, sigma: Float) -> float:
    """Return the fraction of inner faces across which a jump costs little energy.

    A jump across them costs less than 0.1 times the maximum in both of their cells.
    """
    jump, inner = sigma * mesh.face_measures, mesh.face_cells[:, 1] >= 0
    offsets, faces = mesh.cell_faces
    most = np.maximum.reduceat(jump[faces], offsets[:-1])
    owner, other = mesh.face_cells[inner].T
    weak = jump[inner] < _WEAK * np.minimum(most[owner], most[other])
    return float(np.mean(weak)) if len(weak) else 0.0


def _strength(mesh: Mesh, sigma: Float) -> Float:
    """Return each inner face's penalty divided by the smallest penalty in its two cells."""
    inner = mesh.face_cells[:, 1] >= 0
    offsets, faces = mesh.cell_faces
    positive = np.where(sigma > 0.0, sigma, np.inf)[faces]
    least = np.minimum.reduceat(positive, offsets[:-1])
    owner, other = mesh.face_cells[inner].T
    return frozen_float(sigma[inner] / np.minimum(least[owner], least[other]))
