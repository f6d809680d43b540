"""Mesh: points, faces and the two cells beside each face. Everything else is derived."""

from __future__ import annotations

import hashlib
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, field
from functools import cached_property
from typing import TYPE_CHECKING, Any, NamedTuple

import numpy as np
from numpy.typing import ArrayLike, NDArray

from agglo_core.arrays import Float, Int, frozen_float, frozen_int
from agglo_core.errors import MeshError

if TYPE_CHECKING:
    from shapely import MultiPolygon, Polygon

    from agglo_core.graph import Graph
    from agglo_core.hierarchy import Hierarchy

__all__ = ["Loops", "Mesh", "box_centre", "check_labels"]


def box_centre(points: Float) -> Float:
    """Centre ``(d,)`` of the bounding box of ``points (n, d)``."""
    # column by column: numpy reduces the long axis of a narrow array ten times slower
    return frozen_float([0.5 * (column.min() + column.max()) for column in points.T])


class Loops(NamedTuple):
    """Boundary loops of every cell.

    Cell c owns loops ``cell_offsets[c]:cell_offsets[c + 1]``; loop l owns
    ``vertices[loop_offsets[l]:loop_offsets[l + 1]]``. The cell lies on the left of each loop: outer
    loops run counter-clockwise, holes clockwise. No loop meets a vertex twice: at a pinch they part.
    """

    cell_offsets: Int
    loop_offsets: Int
    vertices: Int


@dataclass(frozen=True, eq=False)
class Mesh:
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
        object.__setattr__(self, "cell_tags", _checked_tags("cell", self.cell_tags, self.n_cells))
        object.__setattr__(self, "face_tags", _checked_tags("face", self.face_tags, self.n_faces))

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
            Accept polygons that touch themselves; an edge walked both ways is a bridge to a hole
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
        from agglo_core.mesh.polygons import build_polygons

        return build_polygons(points, cells, cell_tags or {}, merge_points, weak, strict, name)

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
        from agglo_core.mesh.polyhedra import build_polyhedra

        return build_polyhedra(points, cells, cell_tags or {}, merge_points, name)

    @classmethod
    def from_shapely(
        cls,
        polygons: Iterable[Polygon | MultiPolygon],
        *,
        cell_tags: Mapping[str, ArrayLike] | None = None,
        tolerance: float = 0.0,
        strict: bool = False,
        name: str = "",
    ) -> Mesh:
        """Mesh whose cell i is polygon i; see :func:`agglo_core.interchange.mesh_from_shapely`."""
        from agglo_core.interchange import mesh_from_shapely

        return mesh_from_shapely(polygons, cell_tags=cell_tags, tolerance=tolerance, strict=strict, name=name)

    # -- sizes ---------------------------------------------------------------------------------
    @property
    def dim(self) -> int:
        """Space dimension d, 2 or 3."""
        return int(self.points.shape[1])

    @property
    def n_points(self) -> int:
        """Number of points."""
        return len(self.points)

    @property
    def n_faces(self) -> int:
        """Number of faces (edges in 2-D)."""
        return len(self.face_cells)

    @cached_property
    def n_cells(self) -> int:
        """Number of cells."""
        return int(self.face_cells.max(initial=-1)) + 1

    # -- geometry ------------------------------------------------------------------------------
    @cached_property
    def origin(self) -> Float:
        """Bounding-box centre ``(d,)``; computations use coordinates relative to it."""
        used = np.zeros(self.n_points, bool)
        used[self.face_vertices] = True
        return box_centre(self.points if used.all() else self.points[used])

    @cached_property
    def local_points(self) -> Float:
        """Points relative to :attr:`origin`, so that meshes far from 0 lose no digits."""
        return frozen_float(self.points - self.origin)

    @cached_property
    def cell_faces(self) -> tuple[Int, Int]:
        """Face ids of each cell as CSR: offsets ``(n_cells + 1,)`` and faces."""
        from agglo_core.kernels.faces import cell_faces

        offsets, faces = cell_faces(self.face_cells, self.n_cells)
        return frozen_int(offsets), frozen_int(faces)

    @cached_property
    def _moments(self) -> tuple[Float, Float]:
        if self.dim == 3:
            from agglo_core.mesh.geometry3d import polyhedron_moments

            return polyhedron_moments(self)
        from agglo_core.kernels.geometry import polygon_moments

        area, centroid = polygon_moments(
            self.local_points, *self.cell_faces, self.face_pairs, self.face_cells
        )
        return frozen_float(area), frozen_float(centroid)

    @cached_property
    def _face_vectors(self) -> Float:
        """Face normals times face measures, outward from the owner ``(n_faces, d)``."""
        if self.dim == 3:
            from agglo_core.mesh.geometry3d import face_moments

            return face_moments(self.local_points, self.face_offsets, self.face_vertices)[0]
        v0, v1 = self.local_points[self.face_pairs[:, 0]], self.local_points[self.face_pairs[:, 1]]
        edge = v1 - v0
        return frozen_float(np.stack((edge[:, 1], -edge[:, 0]), axis=1))

    @property
    def face_pairs(self) -> Int:
        """``(n_faces, 2)`` vertices of each 2-D face.

        Raises
        ------
        MeshError
            In 3-D, where faces have any number of vertices.
        """
        if self.dim != 2:
            raise MeshError("face_pairs exists only for 2-D meshes; use face_offsets and face_vertices")
        return self.face_vertices.reshape(-1, 2)

    @property
    def cell_measures(self) -> Float:
        """Areas or volumes ``(n_cells,)``, by the divergence theorem: exact for any shape."""
        return self._moments[0]

    @property
    def local_centroids(self) -> Float:
        """Cell centroids relative to :attr:`origin` ``(n_cells, d)``."""
        return self._moments[1]

    @cached_property
    def cell_centroids(self) -> Float:
        """Centroids of the cells ``(n_cells, d)``."""
        return frozen_float(self.local_centroids + self.origin)

    @cached_property
    def face_measures(self) -> Float:
        """Lengths or areas of the faces ``(n_faces,)``."""
        return frozen_float(np.linalg.norm(self._face_vectors, axis=1))

    @cached_property
    def face_normals(self) -> Float:
        """Unit normals outward from the owner ``(n_faces, d)``; 0 for faces of no measure."""
        length = self.face_measures[:, None]
        return frozen_float(self._face_vectors / np.where(length > 0, length, 1.0))

    @cached_property
    def cell_vertices(self) -> tuple[Int, Any]:
        """Vertices of each cell as CSR (offsets int64, vertices int32), in no particular order."""
        from agglo_core.arrays import frozen_index

        offsets, faces = self.cell_faces
        if self.dim == 3:
            from agglo_core.mesh.geometry3d import polyhedron_vertices

            return polyhedron_vertices(self)
        cells = np.repeat(np.arange(self.n_cells), np.diff(offsets))
        side = (self.face_cells[faces, 0] != cells).astype(np.int64)
        return offsets, frozen_index(self.face_vertices[2 * faces + side])

    @cached_property
    def cell_diameters(self) -> Float:
        """Largest vertex distance of each cell ``(n_cells,)``."""
        from agglo_core.kernels.geometry import block_diameters

        cells = frozen_int(np.arange(self.n_cells + 1))
        return frozen_float(block_diameters(cells, cells, *self.cell_vertices, self.local_points))

    @property
    def h(self) -> float:
        """Mesh size: the largest cell diameter (paper, §2.2)."""
        return float(self.cell_diameters.max())

    @cached_property
    def boundary_loops(self) -> Loops:
        """Boundary loops of every cell (2-D).

        Raises
        ------
        MeshError
            In 3-D.
        """
        from agglo_core.kernels.faces import chain_loops

        if self.dim != 2:
            raise MeshError("boundary_loops exists only for 2-D meshes")
        loops = chain_loops(self.local_points, *self.cell_faces, self.face_pairs, self.face_cells)
        return Loops(*(frozen_int(part) for part in loops))

    @cached_property
    def graph(self) -> Graph:
        """Dual graph with cell geometry: one node per cell, one edge per pair of neighbours."""
        from agglo_core.graph import Graph

        return Graph.from_mesh(self)

    @cached_property
    def fingerprint(self) -> str:
        """Hash of points and faces; a hierarchy remembers the mesh it belongs to by it."""
        digest = hashlib.blake2b(digest_size=16)
        for array in (self.points, self.face_offsets, self.face_vertices, self.face_cells):
            digest.update(repr(array.shape).encode())
            digest.update(array.tobytes())
        return digest.hexdigest()

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
        padded = np.append(labels, -1)
        face_cells = padded[self.face_cells]
        kept = np.flatnonzero(face_cells[:, 0] != face_cells[:, 1])
        sizes = np.diff(self.face_offsets)[kept]
        offsets = np.concatenate(([0], np.cumsum(sizes)))
        vertices = np.arange(offsets[-1]) + np.repeat(self.face_offsets[kept] - offsets[:-1], sizes)
        first = np.unique(labels, return_index=True)[1]
        tags = {
            name: values[first]
            for name, values in self.cell_tags.items()
            if (values[first][labels] == values).all()
        }
        return Mesh(
            points=self.points,
            face_offsets=frozen_int(offsets),
            face_vertices=self.face_vertices[vertices],
            face_cells=face_cells[kept],
            cell_tags=tags,
            face_tags={name: values[kept] for name, values in self.face_tags.items()},
            name=self.name,
        )

    # -- interchange ---------------------------------------------------------------------------
    def to_shapely(self) -> NDArray[np.object_]:
        """Each cell as a valid Polygon or MultiPolygon ``(n_cells,)``, holes and pinches included."""
        from agglo_core.interchange import mesh_to_shapely

        return mesh_to_shapely(self)

    def to_pyvista(self, hierarchy: Hierarchy | None = None) -> Any:
        """``pyvista.UnstructuredGrid`` with tags, and labels of every level, as cell data."""
        from agglo_core.interchange import to_pyvista

        return to_pyvista(self, hierarchy)

    def check_labels(self, labels: ArrayLike) -> Int:
        """Labels as ``(n_cells,)`` int64 covering 0..k−1, or MeshError."""
        return check_labels(labels, self.n_cells)


def check_labels(labels: ArrayLike, n: int) -> Int:
    """Labels as ``(n,)`` int64 covering 0..k−1, or MeshError."""
    array = np.asarray(labels)
    if array.shape != (n,) or array.dtype.kind not in "iu":
        raise MeshError(
            f"labels must be ({n},) integers, one per cell; given shape {array.shape}, dtype {array.dtype}"
        )
    array = frozen_int(array)
    if array.min() < 0:
        raise MeshError(f"label of cell {int(array.argmin())} is negative")
    missing = np.flatnonzero(np.bincount(np.minimum(array, n)) == 0)  # labels above n leave gaps below
    if len(missing):
        raise MeshError(f"labels leave gaps: no cell is labelled {int(missing[0])} (of 0..{array.max()})")
    return array


def _checked_tags(kind: str, tags: Mapping[str, ArrayLike], count: int) -> dict[str, Int]:
    """Tags as ``(count,)`` int64, or MeshError naming the tag."""
    checked = {}
    for name, values in tags.items():
        array = np.asarray(values)
        if array.shape != (count,):
            raise MeshError(f"{kind} tag {name!r} has shape {array.shape}, expected ({count},)")
        if array.dtype.kind not in "iub":
            raise MeshError(f"{kind} tag {name!r} must hold integers, not {array.dtype}")
        if array.dtype.kind == "u" and array.size and array.max() > np.iinfo(np.int64).max:
            raise MeshError(f"{kind} tag {name!r} holds {array.max()}, more than an int64 can")
        checked[name] = frozen_int(array)
    return checked
