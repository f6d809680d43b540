"""Find flat cells, and faces whose penalty is large or small relative to other faces of their cells."""

from __future__ import annotations

import numpy as np

from agglo_core.authoring import Float, Int, Mesh, Patches, frozen_float, frozen_int, multigrid

_STRONG = 3.0
"""A face is strong if its penalty exceeds this multiple of the smallest in either cell: many strong faces
make a mesh bad (benchmarks/solve.py --meshes random graded layers)."""
_JOINED = 2.0
"""Cells may share a column if the penalty between them exceeds this multiple of the smallest in either cell.
A smaller value makes larger columns (benchmarks/solve.py --meshes wedges --degrees 1)."""
_WEAK = 0.1
"""A face is weak if a jump costs less than this multiple of the maximum in both cells: many weak faces are
layers of flat cells (benchmarks/solve.py --meshes graded layers)."""

_COLUMN = 64
"""Most cells in a column of flat cells. Their inverse takes the square of this number, but layers of more
cells take several times the iterations."""


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


def flat_part(mesh: Mesh, limit: float, ignored: float = 0.0) -> float:
    """Return the fraction of cells with measure less than ``limit`` times the power d of their diameter.

    In 2-D half the perimeter bounds the diameter. Without computing diameters the result is 0 if this bound
    shows that the fraction is at most ``ignored``.
    """
    measures = mesh.cell_measures
    if mesh.dim == 2:
        offsets, faces = mesh.cell_faces
        perimeters = np.add.reduceat(mesh.face_measures[faces], offsets[:-1])
        if np.mean(measures < limit * (0.5 * perimeters) ** 2) <= ignored:
            return 0.0
    return float(np.mean(measures < limit * mesh.cell_diameters**mesh.dim))


def shape_penalty(mesh: Mesh) -> Float:
    """Return |F| / |T| of each face F with its smaller cell T ``(n_faces,)``, a penalty by shape alone."""
    owner, other = mesh.face_cells.T
    measures = mesh.cell_measures
    smaller = np.minimum(measures[owner], measures[np.where(other < 0, owner, other)])
    return frozen_float(mesh.face_measures / smaller)


def columns(mesh: Mesh) -> tuple[Patches, float]:
    """Join cells across their layers, and return the columns with the fraction of strong pairs they cut.

    Cells are joined by :func:`strong_pairs`, where |F| / |T| replaces the penalty of each face F, with the
    smaller cell T: the sharp penalty of degree 1 hardly depends on the shape of flat cells. A column has up
    to 64 cells.

    Parameters
    ----------
    mesh : Mesh
    """
    pairs = strong_pairs(mesh, shape_penalty(mesh))
    found = multigrid.joined_patches(pairs, mesh.n_cells, most=_COLUMN)
    column = np.empty(mesh.n_cells, np.int64)
    column[found.parts] = np.repeat(np.arange(len(found)), np.diff(found.offsets))
    return found, float(np.mean(np.diff(column[pairs]) != 0)) if len(pairs) else 0.0


def _strength(mesh: Mesh, sigma: Float) -> Float:
    """Return each inner face's penalty divided by the smallest penalty in its two cells."""
    inner = mesh.face_cells[:, 1] >= 0
    offsets, faces = mesh.cell_faces
    positive = np.where(sigma > 0.0, sigma, np.inf)[faces]
    least = np.minimum.reduceat(positive, offsets[:-1])
    owner, other = mesh.face_cells[inner].T
    return frozen_float(sigma[inner] / np.minimum(least[owner], least[other]))
