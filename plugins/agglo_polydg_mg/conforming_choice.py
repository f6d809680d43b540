"""How the recipe with a continuous space is to be run on a mesh: smoother, cycle, precision."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any, Literal

import numpy as np

from agglo_core.authoring import Float, Mesh

__all__ = ["Difficulty", "difficulty"]

_STRONG = 3.0
_BAD = 0.03
_CONTRAST = 1e8


@dataclass(frozen=True)
class Difficulty:
    """What a mesh asks for.

    Attributes
    ----------
    smoother : "cells" or "patches"
        Block Gauss–Seidel on single cells, or on the cells around each vertex.
    bubbles : bool
        Whether the continuous space is to have bubbles.
    kind : "V" or "W"
        Cycle: W solves each coarse level twice.
    dtype : numpy dtype
        Precision of the cycle.
    strong : float
        Part of the inner faces that are strong.
    reason : str
        What of the mesh decided, in words, for a report.
    """

    smoother: Literal["cells", "patches"]
    bubbles: bool
    kind: Literal["V", "W"]
    dtype: Any
    strong: float
    reason: str


def difficulty(mesh: Mesh, sigma: Float, kappa: Float, degree: int) -> Difficulty:
    """Choose by the penalty: where it varies much around cells, single cells are too little to smooth with.

    A face is strong if its penalty is more than 3 times the smallest of one of its cells; a mesh with more
    than 3 % strong inner faces is bad (slivers, boundary layers).

    * Bad meshes: vertex patches, from degree 2 on in double precision: on random triangles cycles in single
      precision broke conjugate gradients off at once.
    * Polygons of more than 4 faces, from degree 2 on: vertex patches, which spare the bubbles.
    * Otherwise single cells. W on bad meshes and polygons, where the aggregates are the weakest part.
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
    >>> from agglo_polydg_mg.conforming_choice import difficulty
    >>> from agglo_polydg_mg.penalty import face_penalty
    >>> mesh = samples.squares(4)
    >>> difficulty(mesh, face_penalty(mesh, 1), np.ones(16), 1).reason
    '0 % strong faces, at most 4 faces a cell'
    """
    strong = _strong_part(mesh, sigma)
    bad, faces = strong > _BAD, int(np.diff(mesh.cell_faces[0]).max())
    polygons = faces > 4
    patches = bad or (polygons and degree > 1)
    kind: Literal["V", "W"] = "W" if bad or polygons else "V"
    contrast = float(kappa.max() / kappa.min())
    double = (bad and degree > 1) or contrast > _CONTRAST
    smoother: Literal["cells", "patches"] = "patches" if patches else "cells"
    dtype = np.float64 if double else np.float32
    reason = f"{100 * strong:.0f} % strong faces, at most {faces} faces a cell"
    return Difficulty(smoother, bad or not patches, kind, dtype, strong, reason)


def _strong_part(mesh: Mesh, sigma: Float) -> float:
    inner = mesh.face_cells[:, 1] >= 0
    if not inner.any():
        return 0.0
    offsets, faces = mesh.cell_faces
    positive = np.where(sigma > 0.0, sigma, np.inf)[faces]
    least = np.minimum.reduceat(positive, offsets[:-1])
    return float(np.mean(sigma[inner] > _STRONG * least[mesh.face_cells[inner]].min(axis=1)))
