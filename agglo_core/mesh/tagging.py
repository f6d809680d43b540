"""Tag cells and faces by functions of the coordinates, and list the occurring combinations of tags."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from functools import cached_property
from typing import Any, NamedTuple, Self

import numpy as np
from numpy.typing import ArrayLike

from agglo_core.arrays import Float, Int, Mask, frozen_int, plain_array, trusted_copy
from agglo_core.errors import MeshError
from agglo_core.mesh.checks import check_tags


class BoundaryKinds(NamedTuple):
    """Combinations of face tag values that occur on the boundary of each domain component.

    Attributes
    ----------
    component : (k,) int
        Component of the domain, by its first cell.
    tags : mapping of name to (k,) int
        Tag values.
    whole : bool
        False on a piece of a distributed mesh, where the cell numbers are those of the whole mesh.
    """

    component: Int
    tags: Mapping[str, Int]
    whole: bool = True


def distinct(columns: Sequence[Int]) -> list[Int]:
    """Return the distinct rows of a table given by columns, in arbitrary order.

    Examples
    --------
    >>> from agglo_core.mesh.tagging import distinct
    >>> distinct([np.array([1, 2, 1]), np.array([5, 5, 5])])
    [array([1, 2]), array([5, 5])]
    """
    if not columns:
        return []
    row = np.zeros(len(columns[0]), np.int64)
    for values in columns:
        own, place = np.unique(values, return_inverse=True)
        row = np.unique(row * len(own) + place, return_inverse=True)[1]
    first = np.unique(row, return_index=True)[1]
    return [frozen_int(np.asarray(values)[first]) for values in columns]


TagValues = ArrayLike | Callable[[Float], ArrayLike]


class Tagged:
    """Base class of :class:`~agglo_core.mesh.Mesh`: integer tags of cells and faces."""

    cell_tags: Mapping[str, Int]
    face_tags: Mapping[str, Int]
    cell_centroids: Any
    face_centroids: Any
    face_cells: Int
    outer_faces: Any
    graph: Any

    @cached_property
    def cell_kinds(self) -> Mapping[str, Int]:
        """Combinations of cell tag values that occur in the mesh, ``(k,)`` per tag.

        A rank's part of a larger mesh holds the combinations of the whole mesh.
        """
        return dict(zip(self.cell_tags, distinct(list(self.cell_tags.values())), strict=True))

    @cached_property
    def boundary_kinds(self) -> BoundaryKinds:
        """Combinations of face tag values that occur on the boundary of each domain component.

        A rank's part of a larger mesh holds the combinations of the whole mesh.
        """
        component = self.graph.components()
        first = np.unique(component, return_index=True)[1]
        outer: Mask = self.outer_faces
        own = first[component[self.face_cells[outer, 0]]]
        found, *tags = distinct([own, *(values[outer] for values in self.face_tags.values())])
        return BoundaryKinds(found, dict(zip(self.face_tags, tags, strict=True)))

    def with_tags(self, /, **tags: TagValues) -> Self:
        """Return this mesh with additional cell tags.

        Tags with these names are replaced.

        Parameters
        ----------
        **tags : function of x, or (n_cells,) int or bool
            By name. A function gets the centroids x ``(n_cells, d)`` and returns a value per row; True
            becomes 1, False 0.

        Raises
        ------
        MeshError
            With the tag name, if the values are not integers or booleans, one per cell.

        Examples
        --------
        >>> from agglo_core import samples
        >>> mesh = samples.squares(2).with_tags(left=lambda x: x[:, 0] < 0.5, rock=[7, 7, 8, 8])
        >>> mesh.cell_tags["left"].tolist(), mesh.cell_tags["rock"].tolist()
        ([1, 0, 1, 0], [7, 7, 8, 8])
        """
        new_tags = _evaluate_tags("cell", tags, self.cell_centroids)
        return trusted_copy(self, cell_tags={**self.cell_tags, **new_tags})

    def with_face_tags(self, /, **tags: TagValues) -> Self:
        """Return this mesh with additional face tags.

        Tags with these names are replaced.

        Parameters
        ----------
        **tags : function of x, or (n_faces,) int or bool
            As for :meth:`with_tags`, with the centroids x of all faces ``(n_faces, d)``, inner faces included
            (edge midpoints in 2-D). Compare with a tolerance in 3-D.

        Raises
        ------
        MeshError
            With the tag name, if the values are not integers or booleans, one per face.

        Examples
        --------
        >>> from agglo_core import samples
        >>> mesh = samples.squares(2).with_face_tags(wall=lambda x: np.isclose(x[:, 0], 0.0))
        >>> int(mesh.face_tags["wall"].sum())
        2
        """
        new_tags = _evaluate_tags("face", tags, self.face_centroids)
        return trusted_copy(self, face_tags={**self.face_tags, **new_tags})


def _evaluate_tags(kind: str, tags: Mapping[str, TagValues], points: Float) -> dict[str, Int]:
    """Evaluate tags given as arrays or functions, as ``(n,)`` integers by name."""
    arrays = {}
    for name, values in tags.items():
        result = values(points) if callable(values) else values
        arrays[name] = plain_array(result, f"{kind} tag {name!r}")
        if callable(values) and arrays[name].shape != (len(points),):
            raise MeshError(
                f"{kind} tag {name!r}: for x of shape {points.shape} the function returned shape "
                f"{arrays[name].shape}, expected ({len(points)},), a value for each row of x"
            )
    return check_tags(kind, arrays, len(points))
