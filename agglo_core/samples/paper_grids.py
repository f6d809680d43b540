"""The four fine grids in the experiments of Antonietti et al., reproduced cell by cell."""

from __future__ import annotations

from typing import Literal

import numpy as np

from agglo_core.arrays import trusted_copy
from agglo_core.errors import OptionError
from agglo_core.mesh import Mesh
from agglo_core.samples.clouds import delaunay_mesh, voronoi_mesh
from agglo_core.samples.regular import squares, triangles


def paper(name: Literal["triangles", "squares", "random", "voronoi"]) -> Mesh:
    """Fine grid of Antonietti et al. (§4): ``triangles``, ``squares``, ``random`` or ``voronoi``.

    128 triangles, 256 squares, 286 Delaunay triangles on 128 random points, or 256 Voronoi cells. The random
    numbers are one MATLAB stream with default seed: first the random points, then the Voronoi seeds.

    Parameters
    ----------
    name : {"triangles", "squares", "random", "voronoi"}
        Grid name.

    Raises
    ------
    OptionError
        For any other name.

    Examples
    --------
    >>> agglo.samples.paper("squares")
    Mesh('paper squares', 2-D, 256 cells, 544 faces, 289 points)
    """
    # MATLAB's default stream: its random points first, then the Voronoi seeds.
    stream = np.random.RandomState(5489)
    cloud, seeds = (stream.rand(2 * m).reshape(2, m).T.copy() for m in (128, 256))
    match name:
        case "triangles":
            mesh = triangles(8)
        case "squares":
            mesh = squares(16)
        case "random":
            mesh = delaunay_mesh(cloud, "")
        case "voronoi":
            mesh = voronoi_mesh(seeds, "")
        case _:
            raise OptionError(
                f"unknown grid {name!r}; the grids of the paper are triangles, squares, random, voronoi"
            )
    return trusted_copy(mesh, name=f"paper {name}")
