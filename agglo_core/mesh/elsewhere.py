"""Methods of meshes and graphs, as ``mesh.graph``, that later packages implement: imported when used."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Mapping, Sequence
from importlib import import_module
from typing import Any, Self

import numpy as np
from numpy.typing import ArrayLike, NDArray


def made_by(target: str) -> Callable[..., Any]:
    """The function ``"module:name"``, imported now, so that this package does not depend on it."""
    module, _, name = target.partition(":")
    function: Callable[..., Any] = getattr(import_module(module), name)
    return function


class Interchange:
    """The part of :class:`~agglo_core.mesh.Mesh` that knows other libraries: to and from them, pictures."""

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

    def plot(
        self,
        ax: Any = None,
        *,
        values: str | ArrayLike | None = None,
        cmap: str = "viridis",
        section: Sequence[float] | None = None,
    ) -> Any:
        """Draw the mesh on axes of matplotlib.

        Plane meshes are drawn in their own coordinates, so that more can be drawn upon them; solids as a
        picture from above and a side.

        Parameters
        ----------
        ax : matplotlib.axes.Axes, optional
            By default those of a new figure of pyplot, which notebooks and ``plt.show()`` show.
        values : str or (n_cells,) float, optional
            What cells are coloured by: the name of a cell tag, with a legend (a colour bar if it has more
            than nine values), or numbers, with a colour bar; grey where they are not finite.
        cmap : str
            Colour map of matplotlib for numbers.
        section : (3,) float, optional
            In 3-D: cells beyond the plane with this normal through the middle are left out.

        Returns
        -------
        matplotlib.axes.Axes

        Raises
        ------
        OptionError
            Without matplotlib, or for an argument that is not as above.

        Examples
        --------
        >>> from agglo_core import samples
        >>> mesh = samples.squares(4).with_tags(rock=lambda x: x[:, 1] < 0.5)
        >>> ax = mesh.plot(values="rock")
        >>> [text.get_text() for text in ax.get_legend().get_texts()]
        ['0', '1']
        """
        return made_by("agglo_core.draw.on_axes:plot_mesh")(
            self, ax, values=values, cmap=cmap, section=section
        )

    def _repr_html_(self) -> str:
        html: str = made_by("agglo_core.draw.notebook:mesh_html")(self)
        return html
