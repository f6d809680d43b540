"""Sample ``cross``."""

from __future__ import annotations

import numpy as np

from agglo_core.authoring import Mesh, OptionError

__all__ = ["cross"]


def cross(n: int = 3) -> Mesh:
    """Cross of five squares with ``n`` by ``n`` cells each.

    The cell tag ``arm`` is 1 on the upright.

    Parameters
    ----------
    n : int
        Cells along the side of a square.
    """
    if n < 1:
        raise OptionError(f"cross: n must be positive, given {n}")
    i, j = (each.ravel() for each in np.indices((3 * n, 3 * n)))
    kept = (i // n == 1) | (j // n == 1)
    i, j, side = i[kept], j[kept], 3 * n + 1
    corner = i * side + j
    cells = np.stack((corner, corner + side, corner + side + 1, corner + 1), axis=1)
    used, cells = np.unique(cells, return_inverse=True)
    points = np.stack(np.divmod(used, side), axis=1) / n
    tags = {"arm": (i // n == 1).astype(int)}
    return Mesh.from_polygons(points, cells.reshape(-1, 4), cell_tags=tags, name=f"cross of {5 * n * n}")
