"""A human brain as a voxel mesh with its tissues, from the MNI152 template.

docs/brain describes the procedure.
"""

from __future__ import annotations

from importlib.resources import as_file, files

import numpy as np

from agglo_core.arrays import Float, Int
from agglo_core.errors import OptionError
from agglo_core.mesh import Mesh
from agglo_core.mesh.elements import polyhedra_from_elements

_EDGE = 2.0  # voxel edge of the file in mm
_COARSEST = 20.0  # largest voxel edge in mm
_SPECK = 8  # in voxels; smaller tissue pieces take the surrounding tissue
_TISSUES = (1, 2, 3)


def brain3d(mm: float = 4.0) -> Mesh:
    """Human brain composed of cubes with edge ``mm`` (millimetres), with the cell tag ``tissue``.

    The values of ``tissue`` are 1 fluid, 2 grey and 3 white matter. The mesh is the MNI152 template without
    skull and scalp: 1.9 litres, so about 1.9e6 / mm³ cells. A cube has its predominant tissue, and is omitted
    if it is more than half outside. Tissue pieces with fewer than eight cubes take the surrounding tissue.
    Coordinates are template coordinates (MNI) in millimetres: x to the right, y to the front, z up.

    Parameters
    ----------
    mm : float
        Cube edge in millimetres, from 2 (the resolution of the data) to 20.

    Examples
    --------
    >>> mesh = brain3d(10)
    >>> mesh, np.bincount(mesh.cell_tags["tissue"]).tolist()
    (Mesh('brain3d 10 mm', 3-D, 1885 cells, 6278 faces, 2562 points), [0, 9, 1307, 569])
    """
    if not isinstance(mm, int | float | np.number) or not _EDGE <= mm <= _COARSEST:
        raise OptionError(
            f"mm of sample brain3d must be a number from {_EDGE:g} to {_COARSEST:g}, not {mm!r:.60}"
        )
    # 1. Load the voxels, and resample them.
    with as_file(files("agglo_core.samples") / "data" / "brain3d.npz") as path, np.load(path) as data:
        fine, low = data["tissue"], data["low"]
    tissue, first = _resample_tissue(fine, low, float(mm))
    tissue = _replace_specks(_largest_piece(tissue))
    # 2. Build one hexahedron per filled voxel.
    voxels = np.argwhere(tissue)
    points, cells = _cubes(voxels)
    return Mesh.from_polyhedra(
        (points + first) * mm,
        polyhedra_from_elements({"hexahedron": cells}),
        cell_tags={"tissue": tissue[tuple(voxels.T)]},
        name=f"brain3d {mm:g} mm",
    )


def _resample_tissue(fine: Int, low: Float, mm: float) -> tuple[Int, Float]:
    """Resample the tissue image to voxels with edge ``mm``, each with its predominant tissue by volume.

    Also returns the grid origin in units of ``mm``. One voxel lies across the middle plane, about which the
    template is symmetric.
    """
    overlaps, first = zip(
        *(_overlaps(start, n, mm) for start, n in zip(low, fine.shape, strict=True)), strict=True
    )
    shares = np.stack([np.einsum("ia,jb,kc,abc->ijk", *overlaps, fine == t, optimize=True) for t in _TISSUES])
    return np.where(shares.sum(axis=0) >= 0.5, 1 + shares.argmax(axis=0), 0), np.array(first)


def _overlaps(start: float, n: int, mm: float) -> tuple[Float, float]:
    """Return the overlap lengths of coarse and fine voxels along an axis, and the first coarse edge."""
    ends = np.array([start, start + n * _EDGE]) / mm
    edges = np.arange(np.floor(ends[0] - 0.5), np.ceil(ends[1] + 0.5) + 1.0) + 0.5
    fine = (start + _EDGE * np.arange(n + 1)) / mm
    low, high = np.maximum(edges[:-1, None], fine[:-1]), np.minimum(edges[1:, None], fine[1:])
    return np.clip(high - low, 0.0, None), float(edges[0])


def _replace_specks(tissue: Int) -> Int:
    """Replace small connected regions of a tissue by the predominant tissue around them."""
    from scipy.ndimage import convolve, label

    cross = np.zeros((3, 3, 3), int)
    cross[1, 1] = cross[1, :, 1] = cross[:, 1, 1] = 1
    # 1. Find the small pieces.
    specks = np.zeros(tissue.shape, bool)
    for each in _TISSUES:
        pieces = label(tissue == each)[0]
        small = np.bincount(pieces.ravel()) < _SPECK
        small[0] = False
        specks |= small[pieces]
    # 2. Vote over the six neighbours.
    kept = np.where(specks, 0, tissue)
    votes = np.stack([convolve((kept == t).astype(int), cross, mode="constant") for t in _TISSUES])
    return np.where(specks & (votes.sum(axis=0) > 0), 1 + votes.argmax(axis=0), tissue)


def _largest_piece(tissue: Int) -> Int:
    """Keep only the largest connected component of the nonzero voxels."""
    from scipy.ndimage import label

    pieces = label(tissue > 0)[0]
    return np.where(pieces == 1 + np.bincount(pieces.ravel())[1:].argmax(), tissue, 0)


def _cubes(voxels: Int) -> tuple[Float, Int]:
    """Return points and corners ``(n, 8)`` of the unit cubes at integer positions, in VTK order."""
    corners = np.array([[0, 0, 0], [1, 0, 0], [1, 1, 0], [0, 1, 0]])
    corners = np.concatenate((corners, corners + np.array([0, 0, 1])))
    places = (voxels[:, None] + corners).reshape(-1, 3)
    shape = places.max(axis=0) + 1
    used, number = np.unique(np.ravel_multi_index(tuple(places.T), tuple(shape)), return_inverse=True)
    return np.stack(np.unravel_index(used, shape), axis=1).astype(float), number.reshape(-1, 8)
