"""Methods of meshes and graphs, as ``mesh.graph``, that later packages implement: imported when used."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Mapping
from importlib import import_module
from typing import Any, Self

import numpy as np
from numpy.typing import ArrayLike, NDArray

__all__ = ["Interchange", "made_by"]


def made_by(target: str) -> Callable[..., Any]:
    """The function ``"module:name"``, imported now, so that this package does not depend on it."""
    module, _, name = target.partition(":")
    function: Callable[..., Any] = getattr(import_module(module), name)
    return function


class Interchange:
    """The part of :class:`~agglo_core.mesh.Mesh` that knows other libraries."""

    @classmethod
    def from_shapely(
        cls,
        polygons: Iterable[Any],
        *,
        cell_tags: Mapping[str, ArrayLike] | None = None,
        tolerance: float = 0.0,
        strict: bool = False,
        name: str = "",
    ) -> Self:
        """Mesh whose cell i is polygon i; see :func:`agglo_core.interchange.mesh_from_shapely`."""
        made: Self = made_by("agglo_core.interchange:mesh_from_shapely")(
            polygons, cell_tags=cell_tags, tolerance=tolerance, strict=strict, name=name
        )
        return made

    def to_shapely(self) -> NDArray[np.object_]:
        """Each cell as a valid Polygon or MultiPolygon ``(n_cells,)``, holes and pinches included."""
        cells: NDArray[np.object_] = made_by("agglo_core.interchange:mesh_to_shapely")(self)
        return cells

    def to_pyvista(self, hierarchy: Any = None) -> Any:
        """``pyvista.UnstructuredGrid`` with tags, and labels of every level of a hierarchy, as cell data."""
        return made_by("agglo_core.interchange:to_pyvista")(self, hierarchy)
