"""How the recipe with a continuous space is to be run on a mesh: smoother, cycle, precision."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any, Literal

import numpy as np

from agglo_core.authoring import Float, Int, Mesh, frozen_float, frozen_int

_STRONG = 3.0
_BAD = 0.06
_UNEASY = 0.01
"""The part of strong faces from which high degrees converge faster on vertex patches, at no more cost."""
_JOINED = 2.0
"""Cells are smoothed together if the penalty between them is this many times the smallest of one of them."""
_WEAK = 0.1
_LAYERS = 0.02
"""A mesh has layers if this part of its inner faces is weak: in both cells a jump costs less than 0.1 of what
it may cost at another face."""
_CONTRAST = 1e8
_TETRAHEDRON, _HEXAHEDRON = 4, 6
_BAD_IN_SPACE = 0.03
"""The part of strong faces from which tetrahedra are bad: on slivers the continuous space loses conjugacy."""
_SMOOTH = 100.0
"""Up to this ratio of the largest to the smallest κ aggregates serve as well as classical levels."""


@dataclass(frozen=True)
class Difficulty:
    """What a mesh asks for.

    Attributes
    ----------
    smoother : "cells", "groups" or "patches"
        Block Gauss–Seidel on single cells, on those that strong faces join, up to eight, or on the cells
        around each vertex.
    bubbles : bool
        Whether the continuous space is to have bubbles.
    vertices : "aggregates" or "classical"
        How the problem on vertices is coarsened.
    layers : bool
        Whether classical levels need a guide: in flat cells couplings of vertices have either sign.
    kind : "V" or "W"
        Cycle: W solves each coarse level twice.
    dtype : numpy dtype
        Precision of the cycle.
    strong : float
        Part of the inner faces that are strong.
    reason : str
        What of the mesh decided, in words, for a report.
    recipe : "conforming", "patches" or "agglomerates"
        That of the solver.
    """

    smoother: Literal["cells", "groups", "patches"]
    bubbles: bool
    vertices: Literal["aggregates", "classical"]
    layers: bool
    kind: Literal["V", "W"]
    dtype: Any
    strong: float
    reason: str
    recipe: Literal["conforming", "patches", "agglomerates"] = "conforming"


def difficulty(mesh: Mesh, sigma: Float, kappa: Float, degree: int) -> Difficulty:
    """Choose by the penalty: where it varies much around cells, those with strong faces belong together.

    A face is strong if its penalty is more than 3 times the smallest of one of its cells; a mesh with more
    than 6 % strong inner faces is bad (slivers, boundary layers).

    * Bad meshes: groups of cells; from degree 2 on vertex patches, and from degree 3 on wherever more than
      1 % of the inner faces are strong.
    * Polygons of more than 4 faces: no bubbles unless the mesh is bad, there are too many; from degree 3 on
      vertex patches.
    * Layers of flat triangles or quadrilaterals: classical levels, guided by the couplings in the cells.
    * Degree 1 on another mesh that is not bad, with κ of about one size: aggregates of vertices, in the
      W-cycle. They are cheap, and alone slow. Classical levels elsewhere, in the V-cycle: they hold where
      couplings jump or point one way, and their matrices are fuller.
    * In space: a continuous space if most cells have at most 6 faces, smoothed agglomerates if not;
      vertex patches on bad meshes, and on tetrahedra and hexahedra where κ spans more than two decades.
    * Double precision where κ spans more than eight decades.

    Parameters
    ----------
    mesh : Mesh
    sigma : (n_faces,) float
        Penalty in 1 / length; 0 on natural faces.
    kappa : (n_cells,) float
    degree : int
        p.

    Examples
    --------
    >>> import numpy as np
    >>> from agglo_core import samples
    >>> from agglo_polydg_mg.solver.conforming_choice import difficulty
    >>> from agglo_polydg_mg.forms.penalty import face_penalty
    >>> mesh = samples.squares(4)
    >>> difficulty(mesh, face_penalty(mesh, 1), np.ones(16), 1).reason
    '0 % strong faces, at most 4 faces a cell'
    """
    strong = _strong_part(mesh, sigma)
    if mesh.dim == 3:
        return _in_space(mesh, strong, kappa, degree)
    sides = np.diff(mesh.cell_faces[0])
    bad, faces = strong > _BAD, int(sides.max())
    layers = bool(np.mean(sides > 4) < 0.5) and _weak_part(mesh, sigma) > _LAYERS
    polygons = faces > 4
    contrast = float(kappa.max() / kappa.min())
    easy = degree == 1 and not (bad or layers) and contrast <= _SMOOTH
    smoother: Literal["cells", "groups", "patches"] = "cells"
    if bad or (degree > 2 and (polygons or strong > _UNEASY)):
        smoother = "patches" if degree > 1 else "groups"
    dtype = np.float64 if contrast > _CONTRAST else np.float32
    reason = f"{100 * strong:.0f} % strong faces, at most {faces} faces a cell"
    return Difficulty(
        smoother,
        bubbles=bad or not polygons,
        vertices="aggregates" if easy else "classical",
        layers=layers,
        kind="W" if easy else "V",
        dtype=dtype,
        strong=strong,
        reason=reason,
    )


def _in_space(mesh: Mesh, strong: float, kappa: Float, degree: int) -> Difficulty:
    """Tetrahedra and hexahedra have a continuous space, bad meshes and jumps patches, others single cells."""
    contrast = float(kappa.max() / kappa.min())
    sides = np.diff(mesh.cell_faces[0])
    polyhedra = bool(np.mean(sides > _HEXAHEDRON) > 0.5)
    bad = strong > _BAD if polyhedra else strong > _BAD_IN_SPACE or contrast > _SMOOTH
    recipe: Literal["conforming", "patches", "agglomerates"] = "agglomerates" if polyhedra else "conforming"
    return Difficulty(
        "patches" if bad else "cells",
        bubbles=not polyhedra,
        vertices="aggregates" if contrast <= _SMOOTH else "classical",
        layers=False,
        kind="W" if degree == 1 and sides.max() == _TETRAHEDRON else "V",
        dtype=np.float64 if contrast > _CONTRAST else np.float32,
        strong=strong,
        reason=f"{100 * strong:.0f} % strong faces, at most {sides.max()} faces a cell",
        recipe="patches" if bad else recipe,
    )


def strong_pairs(mesh: Mesh, sigma: Float) -> Int:
    """Cells ``(m, 2)`` on both sides of faces with more than twice a smallest penalty, strongest first.

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


def _strong_part(mesh: Mesh, sigma: Float) -> float:
    strength = _strength(mesh, sigma)
    return float(np.mean(strength > _STRONG)) if len(strength) else 0.0


def _weak_part(mesh: Mesh, sigma: Float) -> float:
    """Part of the inner faces at which a jump costs little, in both cells, next to their other faces."""
    jump, inner = sigma * mesh.face_measures, mesh.face_cells[:, 1] >= 0
    offsets, faces = mesh.cell_faces
    most = np.maximum.reduceat(jump[faces], offsets[:-1])
    owner, other = mesh.face_cells[inner].T
    weak = jump[inner] < _WEAK * np.minimum(most[owner], most[other])
    return float(np.mean(weak)) if len(weak) else 0.0


def _strength(mesh: Mesh, sigma: Float) -> Float:
    """Penalty of each inner face over the smallest of a face of its cells."""
    inner = mesh.face_cells[:, 1] >= 0
    offsets, faces = mesh.cell_faces
    positive = np.where(sigma > 0.0, sigma, np.inf)[faces]
    least = np.minimum.reduceat(positive, offsets[:-1])
    owner, other = mesh.face_cells[inner].T
    return frozen_float(sigma[inner] / np.minimum(least[owner], least[other]))
