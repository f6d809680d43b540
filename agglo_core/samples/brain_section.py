"""A coronal section of a human brain, meshed from the MNI152 template.

docs/brain describes the procedure.
"""

from __future__ import annotations

from importlib.resources import as_file, files

import numpy as np

from agglo_core.mesh import Mesh


def brain() -> Mesh:
    """Coronal section of a human brain: 13,978 triangles, one simple outline with deep sulci.

    Grey and white matter of the MNI152 template 16 mm behind the anterior commissure, x to the right and z
    up, in millimetres. It replaces the brain section of the paper (§4).

    >>> brain()
    Mesh('brain', 2-D, 13978 cells, 21416 faces, 7439 points)
    """
    return _load("brain")


def brain_holes() -> Mesh:
    """Coronal section with ventricles and interpeduncular cistern as five holes: 13,327 triangles.

    >>> brain_holes()
    Mesh('brain_holes', 2-D, 13327 cells, 20518 faces, 7187 points)
    """
    return _load("brain_holes")


def _load(name: str) -> Mesh:
    """Load a triangle mesh from ``data/<name>.npz``: float32 points, uint16 triangles."""
    with as_file(files("agglo_core.samples") / "data" / f"{name}.npz") as path, np.load(path) as data:
        points, triangles = data["points"].astype(np.float64), data["triangles"].astype(np.int64)
    return Mesh.from_polygons(points, triangles, name=name)
