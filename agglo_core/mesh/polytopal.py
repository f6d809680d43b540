"""Mesh: points, faces and the two cells beside each face. Everything else is derived."""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, field
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from agglo_core.arrays import Float, Int, frozen_float, frozen_int
from agglo_core.errors import MeshError
from agglo_core.mesh.checks import check_labels, check_tags
from agglo_core.mesh.coarsening import coarse_faces, surviving_tags
from agglo_core.mesh.derived import Derived
from agglo_core.mesh.elsewhere import made_by
from agglo_core.mesh.polygons import Faces, build_polygons
from agglo_core.mesh.polyhedra import build_polyhedra

__all__ = ["Mesh"]


@dataclass(frozen=True, eq=False)
class Mesh(Derived):
    """A polygonal (d = 2) or polyhedral (d = 3) mesh, face by face.

    Build one with :meth:`from_polygons`, :meth:`from_polyhedra`, :func:`agglo_core.read` or
    :mod:`agglo_core.samples`; these check their input. An agglomerate is just a bigger cell, so
    :meth:`coarsen` gives a Mesh again.

    Attributes
    ----------
    points : (n_points, d) float
        Vertex coordinates.
    face_offsets : (n_faces + 1,) int
        Face f has the vertices ``face_vertices[face_offsets[f]:face_offsets[f + 1]]``.
    face_vertices : (v,) int
        In 2-D two per face, the owner on the left; in 3-D counter-clockwise seen from outside
        the owner.
    face_cells : (n_faces, 2) int
        Owner and neighbour cell; −1 is outside the domain.
    cell_tags, face_tags : mapping of name to (n_cells,) or (n_faces,) int
        Materials, boundary patches.
    repairs : mapping of text to count
        What was normalised when the mesh was built.
    name : str
        For reports.
    """

    points: Float
    face_offsets: Int
    face_vertices: Int
    face_cells: Int
    cell_tags: Mapping[str, Int] = field(default_factory=dict)
    face_tags: Mapping[str, Int] = field(default_factory=dict)
    repairs: Mapping[str, int] = field(default_factory=dict)
    name: str = ""

    def __post_init__(self) -> None:
        object.__setattr__(self, "points", frozen_float(self.points))
        for key in ("face_offsets", "face_vertices", "face_cells"):
            object.__setattr__(self, key, frozen_int(getattr(self, key)))
        if self.points.ndim != 2 or self.points.shape[1] not in (2, 3):
            raise MeshError(f"points must have shape (n_points, 2) or (n_points, 3), not {self.points.shape}")
        if self.face_cells.ndim != 2 or self.face_cells.shape[1] != 2:
            raise MeshError(f"face_cells must have shape (n_faces, 2), not {self.face_cells.shape}")
        if len(self.face_offsets) != self.n_faces + 1 or self.face_offsets[-1] != len(self.face_vertices):
            raise MeshError("face_offsets do not match face_cells and face_vertices")
        vertices, cells = self.face_vertices, self.face_cells
        if len(vertices) and (vertices.min() < 0 or vertices.max() >= self.n_points):
            raise MeshError(f"face_vertices must lie in 0..{self.n_points - 1}")
        if len(cells) and (cells[:, 0].min() < 0 or cells[:, 1].min() < -1):
            raise MeshError("every face needs an owner cell, and a neighbour cell or -1")
        object.__setattr__(self, "cell_tags", check_tags("cell", self.cell_tags, self.n_cells))
        object.__setattr__(self, "face_tags", check_tags("face", self.face_tags, self.n_faces))

    @classmethod
    def from_polygons(
        cls,
        points: ArrayLike,
        cells: Sequence[Sequence[int]] | ArrayLike | tuple[ArrayLike, ArrayLike],
        *,
        cell_tags: Mapping[str, ArrayLike] | None = None,
        merge_points: bool = False,
        weak: bool = False,
        strict: bool = False,
        name: str = "",
    ) -> Mesh:
        """Mesh from polygons given as vertex loops.

        Parameters
        ----------
        points : (n_points, 2) float
            Coordinates; a third column is accepted if it is constant.
        cells : list of index loops, (n, k) integers, or a tuple of two 1-D arrays (offsets, vertices)
            Loops in either direction (clockwise ones are reversed and counted). Two cells are
            neighbours if they list the same two vertices in a row: a vertex that hangs on a
            neighbour's edge must be listed by that neighbour too, or the cells stay apart
            (``strict=True`` reports it, :meth:`from_shapely` inserts it).
        cell_tags : mapping of name to (n,) integers, optional
        merge_points : bool
            Merge exactly equal points first.
        weak : bool
            Accept polygons that touch themselves; an edge traversed both ways is a bridge to a hole
            and is dropped.
        strict : bool
            Also refuse cells that overlap and vertices that lie unlisted on a neighbour's edge.

        Raises
        ------
        MeshError
            Naming cells or faces: non-finite coordinates, too few or repeated vertices, zero area,
            self-intersection, duplicate cells, more than two cells on a face, an empty mesh,
            a surface in 3-D.
        """
        faces = build_polygons(points, cells, merge_points, weak, strict)
        return cls._of(faces, cell_tags, name)

    @classmethod
    def from_polyhedra(
        cls,
        points: ArrayLike,
        cells: Sequence[Sequence[Sequence[int]]] | tuple[ArrayLike, ArrayLike, ArrayLike],
        *,
        cell_tags: Mapping[str, ArrayLike] | None = None,
        merge_points: bool = False,
        name: str = "",
    ) -> Mesh:
        """Mesh from polyhedra given as lists of faces (vertex loops).

        Parameters
        ----------
        points : (n_points, 3) float
        cells : list of cells, each a list of loops; or (cell_offsets, loop_offsets, vertices)
            Cell c owns loops ``cell_offsets[c]:cell_offsets[c + 1]`` of the CSR of loops.
        cell_tags, merge_points, name
            As in :meth:`from_polygons`.

        Raises
        ------
        MeshError
            Naming cells or faces, as in :meth:`from_polygons`; also a cell whose faces do not close.
        """
        return cls._of(build_polyhedra(points, cells, merge_points), cell_tags, name)

    @classmethod
    def _of(cls, faces: Faces, cell_tags: Mapping[str, ArrayLike] | None, name: str) -> Mesh:
        tags = {key: np.array(values) for key, values in (cell_tags or {}).items()}
        return cls(**faces._asdict(), cell_tags=tags, name=name)

    @classmethod
    def from_shapely(
        cls,
        polygons: Iterable[Any],
        *,
        cell_tags: Mapping[str, ArrayLike] | None = None,
        tolerance: float = 0.0,
        strict: bool = False,
        name: str = "",
    ) -> Mesh:
        """Mesh whose cell i is polygon i; see :func:`agglo_core.interchange.mesh_from_shapely`."""
        made: Mesh = made_by("agglo_core.interchange:mesh_from_shapely")(
            polygons, cell_tags=cell_tags, tolerance=tolerance, strict=strict, name=name
        )
        return made

    def __repr__(self) -> str:
        name = f"{self.name!r}, " if self.name else ""
        return f"Mesh({name}{self.dim}-D, {self.n_cells} cells, {self.n_faces} faces, {self.n_points} points)"

    # -- agglomeration -------------------------------------------------------------------------
    def coarsen(self, labels: ArrayLike) -> Mesh:
        """Mesh whose cells are the agglomerates of this one's.

        Points are kept, interior faces dropped. A cell tag survives if it is constant on every
        agglomerate; face tags survive.

        Parameters
        ----------
        labels : (n_cells,) int
            Agglomerate of each cell, all of 0..k−1 in use.

        Raises
        ------
        MeshError
            If the labels have another shape, or leave gaps.
        """
        labels = self.check_labels(labels)
        left = coarse_faces(labels, self.face_offsets, self.face_vertices, self.face_cells)
        return Mesh(
            self.points,
            left.offsets,
            left.vertices,
            left.cells,
            cell_tags=surviving_tags(self.cell_tags, labels),
            face_tags={name: values[left.kept] for name, values in self.face_tags.items()},
            name=self.name,
        )

    # -- interchange ---------------------------------------------------------------------------
    def to_shapely(self) -> NDArray[np.object_]:
        """Each cell as a valid Polygon or MultiPolygon ``(n_cells,)``, holes and pinches included."""
        cells: NDArray[np.object_] = made_by("agglo_core.interchange:mesh_to_shapely")(self)
        return cells

    def to_pyvista(self, hierarchy: Any = None) -> Any:
        """``pyvista.UnstructuredGrid`` with tags, and labels of every level of a hierarchy, as cell data."""
        return made_by("agglo_core.interchange:to_pyvista")(self, hierarchy)

    def check_labels(self, labels: ArrayLike) -> Int:
        """Labels as ``(n_cells,)`` int64 covering 0..k−1, or MeshError."""
        return check_labels(labels, self.n_cells)
