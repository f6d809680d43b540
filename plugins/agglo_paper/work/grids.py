"""Meshes and targets: the paper's four meshes, newly generated meshes in four families, brain sections."""

from __future__ import annotations

from math import sqrt
from pathlib import Path
from typing import Any, Final, cast
from zipfile import BadZipFile

import numpy as np

from agglo_core.authoring import Mesh, OptionError, read, samples
from agglo_paper.work.strategies import Targets

GRIDS: Final = ("triangles", "random", "voronoi", "squares")
SIZES: Final = (sqrt(2) / 8, sqrt(2) / 4, sqrt(2) / 2)
"""Largest diameters on the three levels of every grid, as in the authors' runs."""

FAMILIES: Final = ("perturbed triangles", "random triangles", "Voronoi", "perturbed squares")
_FIRST_SEED = 90_000  # seeds of fresh meshes, not used for training or tuning
_JITTER, _ROOM = 0.1, 1.2
_ARRAYS: Final = {"points", "cell_offsets", "cell_vertices"}
_BRAIN_SHARE, _BRAIN_PARTS = 0.2, 50


def load(source: str, numbering: int = 0) -> Mesh:
    """Load or generate the mesh that a text identifies.

    The text is ``paper:NAME``, ``fresh:FAMILY:NUMBER``, ``brain`` or ``file:DIGEST:PATH``.

    Parameters
    ----------
    source : str
    numbering : int
        If positive, cells are renumbered at random from this seed.
    """
    kind, _, name = source.partition(":")
    if kind == "paper":
        mesh = samples.paper(cast("Any", name))
    elif kind == "fresh":
        family, _, number = name.rpartition(":")
        mesh = _fresh(family, int(number))
    elif kind == "file":
        mesh = _from_file(Path(name.partition(":")[2]))
    else:
        mesh = samples.brain()
    return _renumber_cells(mesh, numbering) if numbering else mesh


def targets(mesh: Mesh, source: str, convention: str) -> Targets:
    """Return the agglomeration targets for a mesh: largest diameters and part counts.

    ``levels``: the three levels in the multigrid tables; ``run``: the middle level, √2/4 or N0/16 parts;
    ``text``: the middle level with 4 h0, as in the paper's text; ``brain``: 0.2 D or 50 parts.
    """
    if convention == "brain":
        return Targets((_BRAIN_SHARE * float(mesh.graph.diameters()[0]),), (_BRAIN_PARTS,))
    counts = tuple(max(1, mesh.n_cells // share) for share in (4, 16, 64))
    if convention == "text":
        return Targets((4 * mesh.h,), counts[1:2])
    room = _ROOM if "perturbed" in source else 1.0
    sizes = tuple(room * size for size in SIZES)
    return Targets(sizes, counts) if convention == "levels" else Targets(sizes[1:2], counts[1:2])


def _fresh(family: str, number: int) -> Mesh:
    seed = _FIRST_SEED + number
    match family:
        case "random triangles":
            return samples.random_triangles(128, seed)
        case "Voronoi":
            return samples.voronoi(256, seed)
        case "perturbed triangles":
            return _perturb_points(samples.triangles(8), 1 / 8, seed)
        case "perturbed squares":
            return _perturb_points(samples.squares(16), 1 / 16, seed)
    raise OptionError(f"no family {family!r}; there are {', '.join(FAMILIES)}")


def _perturb_points(mesh: Mesh, spacing: float, seed: int) -> Mesh:
    """Move each interior point by up to a tenth of the mesh spacing in x and y."""
    inner = np.all((mesh.points > 0) & (mesh.points < 1), axis=1, keepdims=True)
    moves = np.random.default_rng(seed).uniform(-1, 1, mesh.points.shape) * _JITTER * spacing
    loops = mesh.boundary_loops
    points = mesh.points + np.where(inner, moves, 0.0)
    return Mesh.from_polygons(points, (loops.loop_offsets, loops.vertices), name=f"perturbed {mesh.name}")


def _renumber_cells(mesh: Mesh, seed: int) -> Mesh:
    """Permute the cell numbers at random."""
    loops = mesh.boundary_loops
    cells = np.split(loops.vertices, loops.loop_offsets[1:-1])
    order = np.random.default_rng(seed).permutation(mesh.n_cells)
    return Mesh.from_polygons(mesh.points, [cells[cell] for cell in order], name=mesh.name)


def _from_file(path: Path) -> Mesh:
    """Read a mesh from a file in any format, or from an ``.npz`` file with polygon arrays.

    These are points, cell_offsets and cell_vertices.
    """
    if path.suffix == ".npz":
        try:
            with np.load(path) as data:
                arrays = {name: data[name] for name in data} if set(data) == _ARRAYS else {}
        except (OSError, ValueError, EOFError, BadZipFile):
            arrays = {}  # the reader reports the error
        if arrays:
            cells = arrays["cell_offsets"], arrays["cell_vertices"]
            return Mesh.from_polygons(arrays["points"], cells, name=path.stem)
    return read(path)
