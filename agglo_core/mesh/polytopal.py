"""Mesh class: points, faces and the two cells at each face.

All other quantities are derived.
"""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, field
from functools import cached_property
from os import PathLike
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from agglo_core.arrays import FieldState, Float, Int, frozen, owned, trusted, trusted_copy
from agglo_core.errors import OptionError
from agglo_core.mesh.cell_lists import CellList, PolygonList, PolyhedronList
from agglo_core.mesh.checks import check_faces, check_points, check_tags, note_repairs, whole_numbers
from agglo_core.mesh.coarsening import coarse_faces, surviving_tags
from agglo_core.mesh.construction.closed_cells import check_cells, check_volumes
from agglo_core.mesh.construction.conforming import TOLERANCE, join_outer_faces
from agglo_core.mesh.construction.double_cover import warn_of_double_cover
from agglo_core.mesh.construction.polygons import Faces, build_polygons
from agglo_core.mesh.construction.polyhedra import build_polyhedra
from agglo_core.mesh.derived import Derived
from agglo_core.mesh.elsewhere import import_function
from agglo_core.mesh.renumbering import renumber_arrays
from agglo_core.mesh.simplify.edges import MAX_TOLERANCE, fewer_edges
from agglo_core.mesh.simplify.patches import fewer_faces
from agglo_core.mesh.simplify.record import Simplification, record_simplification
from agglo_core.mesh.tagging import Tagged

if TYPE_CHECKING:
    from agglo_core.graph import Graph


@dataclass(frozen=True, eq=False)
class Mesh(FieldState, Derived, Tagged):
    """A polygonal (d = 2) or polyhedral (d = 3) mesh, stored as faces with their vertices and cells.

    Create meshes with :meth:`from_polygons`, :meth:`from_polyhedra`, :func:`agglo_core.read` or
    :mod:`agglo_core.samples`, or from the arrays below, which are copied unless they are immutable. An
    agglomerate is simply a larger cell, so :meth:`coarsen` returns a Mesh.

    Attributes
    ----------
    points : (n_points, d) float
        Vertex coordinates.
    face_offsets : (n_faces + 1,) int
        Face f has the vertices ``face_vertices[face_offsets[f]:face_offsets[f + 1]]``.
    face_vertices : (v,) int
        In 2-D two per face, the owner on the left; in 3-D counter-clockwise from outside the owner.
    face_cells : (n_faces, 2) int
        Owner and neighbour cell; −1 is outside the domain.
    cell_tags, face_tags : mapping of name to (n_cells,) or (n_faces,) int
        Materials, boundary patches.
    repairs : mapping of text to count
        Normalisations during the construction.
    name : str
        For reports.
    simplification : Simplification, optional
        Changes by :meth:`simplified`, if it created the mesh.

    Raises
    ------
    MeshError
        If the arrays have other shapes or hold masked entries, non-finite points, fractions or numbers out
        of range; if cells have no faces, open surfaces, or no positive measure. Only :meth:`from_polygons`
        detects cells that cross themselves or overlap.
    """

    points: Float
    face_offsets: Int
    face_vertices: Int
    face_cells: Int
    cell_tags: Mapping[str, Int] = field(default_factory=dict)
    face_tags: Mapping[str, Int] = field(default_factory=dict)
    repairs: Mapping[str, int] = field(default_factory=dict)
    name: str = ""
    simplification: Simplification | None = None

    def __post_init__(self) -> None:
        arrays = {"points": check_points(self.points)}
        for name, dimensions in (("face_offsets", 1), ("face_vertices", 1), ("face_cells", 2)):
            arrays[name] = owned(whole_numbers(getattr(self, name), name, dimensions))
        self.__dict__.update(arrays)
        self.check()
        self.__dict__["cell_tags"] = check_tags("cell", self.cell_tags, self.n_cells)
        self.__dict__["face_tags"] = check_tags("face", self.face_tags, self.n_faces)

    def check(self) -> None:
        """Raise MeshError unless the arrays form a valid mesh, as the constructor does."""
        check_faces(self.points, self.face_offsets, self.face_vertices, self.face_cells)
        check_cells(self)

    @classmethod
    def from_polygons(
        cls,
        points: ArrayLike,
        cells: Sequence[Sequence[int]] | ArrayLike | tuple[ArrayLike, ArrayLike],
        *,
        cell_tags: Mapping[str, ArrayLike] | None = None,
        merge_points: bool | None = None,
        allow_gaps: bool = False,
        drop_flat: bool = False,
        weak: bool = False,
        strict: bool = False,
        name: str = "",
    ) -> Mesh:
        """Build a mesh from polygons given as vertex loops.

        Overlapping cells cause a warning with the difference between total and union measure.
        This check takes a few per cent of the construction time, because it examines outer faces only.

        Parameters
        ----------
        points : (n_points, 2) float
            Coordinates; a constant third column is accepted.
        cells : list of index loops, (n, k) integers, or a tuple of two 1-D arrays (offsets, vertices)
            Loops in either direction (clockwise loops are reversed and counted). Repeated consecutive
            vertices, as in closed and padded loops, count once. Masked entries at the end of a row are
            padding.
        cell_tags : mapping of name to (n,) integers, optional
        merge_points : bool, optional
            True merges all exactly equal points first, False merges no points. By default coincident points
            are merged where outer edges coincide, as in :meth:`conforming`.
        allow_gaps : bool
            Keep coincident outer edges: a crack, touching bodies. By default they are joined, and hanging
            vertices are inserted into the edges of neighbours.
        drop_flat : bool
            Drop cells with zero area or volume, and renumber the others in order.
        weak : bool
            Accept self-touching polygons; an edge traversed in both directions is a bridge to a hole and is
            dropped.
        strict : bool
            Also reject overlapping cells and unlisted vertices on a neighbour's edge.

        Raises
        ------
        MeshError
            With cells or faces: non-finite coordinates, too few vertices, a revisited vertex, zero area,
            self-intersection, duplicates, more than two cells at a face, no cells, a surface in 3-D, masked
            entries that are no padding.
        """
        built = build_polygons(points, cells, bool(merge_points), weak, strict, drop_flat)
        mesh = cls._of(*built, cell_tags, name)
        mesh = mesh if allow_gaps else mesh.conforming(merge_points=merge_points is not False)
        if not strict:
            warn_of_double_cover(mesh)
        return mesh

    @classmethod
    def from_polyhedra(
        cls,
        points: ArrayLike,
        cells: Sequence[Sequence[Sequence[int]]] | tuple[ArrayLike, ArrayLike, ArrayLike],
        *,
        cell_tags: Mapping[str, ArrayLike] | None = None,
        merge_points: bool | None = None,
        allow_gaps: bool = False,
        drop_flat: bool = False,
        name: str = "",
    ) -> Mesh:
        """Build a mesh from polyhedra given as lists of faces (vertex loops).

        Unlike in :meth:`from_polygons`, cells that overlap without a common face are not detected.

        Parameters
        ----------
        points : (n_points, 3) float
        cells : list of cells, each a list of loops; or (cell_offsets, loop_offsets, vertices)
            Cell c owns loops ``cell_offsets[c]:cell_offsets[c + 1]``, each in either direction. Shells
            inside a shell bound cavities. Faces without area due to repeated vertices are dropped.
        cell_tags, merge_points, allow_gaps, drop_flat, name
            As in :meth:`from_polygons`.

        Raises
        ------
        MeshError
            With cells or faces, as in :meth:`from_polygons`; also for cells with open surfaces, and for outer
            faces that overlap partially (unless ``allow_gaps=True``).
        """
        faces, kept, n = build_polyhedra(points, cells, bool(merge_points), drop_flat)
        mesh = cls._of(faces, kept, n, cell_tags, name)
        check_volumes(mesh, kept)
        return mesh if allow_gaps else mesh.conforming(merge_points=merge_points is not False)

    @classmethod
    def _of(
        cls, faces: Faces, cells: Int, n: int, cell_tags: Mapping[str, ArrayLike] | None, name: str
    ) -> Mesh:
        tags = check_tags("cell", {} if cell_tags is None else cell_tags, n)
        if len(cells) < n:
            tags = {key: frozen(values[cells], values.dtype) for key, values in tags.items()}
        return trusted(cls, **faces._asdict(), cell_tags=tags, name=name)

    @cached_property
    def graph(self) -> Graph:
        """Dual graph: one node per cell, one edge per pair of cells with a common face."""
        from agglo_core.graph import dual_graph

        return dual_graph(self)

    @cached_property
    def cells(self) -> CellList:
        """Sequence of the vertex numbers of each cell, as read-only arrays.

        In 2-D a cell is its vertex loop ``(k,)``, counter-clockwise. Further loops, such as holes, are joined
        to the first by an edge that is traversed in both directions. In 3-D a cell is a list of faces, each a
        vertex loop, counter-clockwise from outside. :meth:`from_polygons` (with ``weak=True`` for cells of
        several loops) and :meth:`from_polyhedra` accept the sequence.

        Cells are computed on access, so a large mesh has no list of a million arrays. Computations on all
        cells are faster with the CSR arrays :attr:`boundary_loops`, :attr:`cell_faces` and
        :attr:`cell_vertices`.

        Raises
        ------
        FileError
            In 2-D, if no free edge can join the loops of a cell.

        Examples
        --------
        >>> from agglo_core import samples
        >>> mesh = samples.squares(2)
        >>> len(mesh.cells), mesh.cells[0], mesh.cells[-1]
        (4, array([0, 1, 4, 3]), array([4, 5, 8, 7]))
        >>> cube = samples.boxes(1).cells[0]
        >>> len(cube), cube[0]
        (6, array([0, 4, 6, 2]))
        """
        if self.dim == 3:
            return PolyhedronList(self)
        from agglo_core.io.to_mesh.bridges import single_loops

        offsets, vertices, _ = single_loops(self)
        return PolygonList(offsets, vertices)

    def write(self, path: str | PathLike[str], **options: Any) -> None:
        """Write the mesh to a file, by :func:`agglo_core.write`.

        Parameters
        ----------
        path : path
            The suffix selects the format.
        **options : optional
            Keyword arguments of :func:`agglo_core.write`, such as ``compress``.

        Raises
        ------
        FileError, MeshError, OptionError, PluginError
            As for :func:`agglo_core.write`.

        Examples
        --------
        >>> agglo.samples.squares(4).write("squares.vtu")
        >>> agglo.read("squares.vtu").n_cells
        16
        """
        from agglo_core.io import write

        write(path, self, **options)

    def __repr__(self) -> str:
        name = f"{self.name!r}, " if self.name else ""
        return f"Mesh({name}{self.dim}-D, {self.n_cells} cells, {self.n_faces} faces, {self.n_points} points)"

    def coarsen(self, labels: ArrayLike) -> Mesh:
        """Return the mesh whose cells are the agglomerates.

        Points are kept, interior faces dropped. Cell tags are kept if they are constant on every agglomerate;
        face tags are always kept.

        Parameters
        ----------
        labels : (n_cells,) int
            Agglomerate per cell, all of 0..k−1 in use.

        Raises
        ------
        MeshError
            If the labels have another shape, or leave gaps.
        """
        labels = self.check_labels(labels)
        coarse = coarse_faces(labels, self.face_offsets, self.face_vertices, self.face_cells)
        faces = coarse.offsets, coarse.vertices, coarse.cells
        cell_tags = surviving_tags(self.cell_tags, labels)
        face_tags = {name: values[coarse.kept] for name, values in self.face_tags.items()}
        mesh = trusted(Mesh, self.points, *faces, cell_tags, face_tags, name=self.name)
        # Outer faces are kept, so both meshes have the same bounding box, and share the local points.
        mesh.__dict__.update(origin=self.origin, local_points=self.local_points)
        return mesh

    def conforming(self, *, tolerance: float = TOLERANCE, merge_points: bool = True) -> Mesh:
        """Return this mesh with coincident outer faces joined (unchanged if there are none).

        In 2-D, vertices on the interior of a neighbour's outer edge are inserted there, so that cells with
        different sizes become neighbours. Coincident points are merged at joined faces. Cells keep their
        numbers. Both parts of a split face inherit its tags; a joined face has the tags of its first face, or
        of the second where the first has −1. ``repairs`` counts all changes. Faces that coincide without
        fitting (overlapping cells) stay separate, with a warning.

        Construction and reading include this step unless ``allow_gaps=True``.

        Parameters
        ----------
        tolerance : float
            Distance within which faces coincide, relative to length and height of the smaller cell. The
            default is above rounding errors and far below intended gaps; coordinates with few digits may
            need more.
        merge_points : bool
            Merge coincident points; otherwise only faces with identical points, after the insertion of
            vertices, are joined.

        Raises
        ------
        OptionError
            If the tolerance is not a number from 0 to 0.01.
        MeshError
            With cells, for outer faces in 3-D that overlap partially, because these are not split.

        Examples
        --------
        >>> points = [[0, 0], [1, 0], [1, 2], [0, 2], [2, 0], [2, 1], [1, 1], [2, 2]]
        >>> apart = Mesh.from_polygons(points, [[0, 1, 2, 3], [1, 4, 5, 6], [6, 5, 7, 2]], allow_gaps=True)
        >>> mesh = apart.conforming()
        >>> mesh.repairs, len(apart.graph.indices), len(mesh.graph.indices)
        ({'hanging vertices inserted': 1}, 2, 6)
        """
        if not 0 <= tolerance <= 0.01:
            raise OptionError(f"conforming: tolerance must lie between 0 and 0.01, given {tolerance!r}")
        joined_mesh = join_outer_faces(self, tolerance, merge_points)
        if joined_mesh is None:
            return self
        points, offsets, vertices, cells, (first, second), repairs = joined_mesh
        tags = {
            name: np.where(values[first] == -1, values[second], values[first])
            for name, values in self.face_tags.items()
        }
        all_repairs = {**self.repairs, **note_repairs(repairs)}
        return trusted(Mesh, points, offsets, vertices, cells, self.cell_tags, tags, all_repairs, self.name)

    def simplified(self, tolerance: float = 0.0) -> Mesh:
        """Return this mesh with collinear edges between the same two cells merged into single edges.

        In 3-D, flat face patches are merged into one face if its boundary is a single loop. Without tolerance
        the geometry changes by rounding only. With a tolerance (2-D), interfaces are straightened: a vertex
        without other edges is removed if its distance from the new edge is within this fraction of the
        smaller cell's diameter. The domain boundary and the total measure are preserved. Cells remain
        polygons without crossings and keep at least half their measure; interfaces keep more vertices where
        this would fail. The result is not a coarsening of the old mesh, and ``simplification.exact`` is
        False.

        Faces with different tags are not merged. Cells keep their numbers; points and faces are renumbered.
        ``simplification`` holds the old numbers, counts, and the change of each cell's measure.

        Raises
        ------
        OptionError
            If the tolerance is not a number from 0 to 0.5, or not 0 in 3-D.

        Examples
        --------
        >>> from agglo_core import samples
        >>> mesh = samples.squares(4).coarsen([0, 0, 1, 1] * 4).simplified()
        >>> mesh.n_faces, mesh.simplification.faces_saved
        (7, 13)
        """
        if not 0 <= tolerance <= MAX_TOLERANCE:
            raise OptionError(
                f"simplified: tolerance must lie between 0 and {MAX_TOLERANCE}, given {tolerance!r}"
            )
        if self.dim == 3:
            if tolerance > 0:
                raise OptionError(
                    "simplified: tolerance must be 0 in 3-D, where only flat patches become one face; "
                    f"given {tolerance!r}"
                )
            reduction = fewer_faces(self, self.face_tags)
        else:
            reduction = fewer_edges(self, self.face_tags, tolerance)
        faces = reduction.face_offsets, reduction.face_vertices, self.face_cells[reduction.leads]
        tags = {name: values[reduction.leads] for name, values in self.face_tags.items()}
        fewer = self.n_faces - len(reduction.leads)
        if tolerance:
            saved = note_repairs({f"faces fewer, interfaces moved within {tolerance:g} of the cells": fewer})
        else:  # the same shapes, so there is nothing to note
            saved = {"straight faces joined": fewer} if fewer else {}
        all_repairs = {**self.repairs, **saved}
        mesh = trusted(
            Mesh, self.points[reduction.points], *faces, self.cell_tags, tags, all_repairs, self.name
        )
        return trusted_copy(mesh, simplification=record_simplification(self, mesh, reduction, tolerance))

    def renumbered(self, cells: ArrayLike) -> Mesh:
        """Return this mesh with the cells in another order.

        Faces and points are numbered as they are encountered.

        Tags are permuted with cells and faces; points without faces are dropped.

        Parameters
        ----------
        cells : (n_cells,) int
            Cells that become cells 0, 1, ….

        Raises
        ------
        MeshError
            If ``cells`` is not a permutation.
        """
        new = renumber_arrays(self, cells)
        cell_tags = {name: values[new.old_cells] for name, values in self.cell_tags.items()}
        face_tags = {name: values[new.old_faces] for name, values in self.face_tags.items()}
        return trusted(Mesh, *new[:4], cell_tags, face_tags, self.repairs, self.name)

    # -- other packages ------------------------------------------------------------------------
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
        """Create a mesh whose cell i is polygon i, see :func:`agglo_core.interchange.mesh_from_shapely`."""
        from agglo_core.interchange import mesh_from_shapely

        return mesh_from_shapely(polygons, cell_tags=cell_tags, tolerance=tolerance, strict=strict, name=name)

    def to_shapely(self) -> NDArray[np.object_]:
        """Return cells as valid shapely polygons or multipolygons ``(n_cells,)``, with holes and pinches."""
        from agglo_core.interchange import mesh_to_shapely

        return mesh_to_shapely(self)

    def to_pyvista(self, hierarchy: Any = None) -> Any:
        """Return a ``pyvista.UnstructuredGrid`` with tags and all level labels as cell data."""
        from agglo_core.interchange import to_pyvista

        return to_pyvista(self, hierarchy)

    def plot(
        self,
        ax: Any = None,
        *,
        values: str | ArrayLike | None = None,
        cmap: str = "viridis",
        section: Sequence[float] | None = None,
    ) -> Any:
        """Draw the mesh on matplotlib axes.

        2-D meshes are drawn in their own coordinates, so that more can be drawn on top; 3-D meshes are drawn
        as a picture seen obliquely from above.

        Parameters
        ----------
        ax : matplotlib.axes.Axes, optional
            By default the axes of a new pyplot figure, displayed by notebooks and ``plt.show()``.
        values : str or (n_cells,) float, optional
            Cell colours: a cell tag name, with a legend (a colour bar for more than nine values), or
            numbers, with a colour bar; grey for non-finite values.
        cmap : str
            Matplotlib colour map for numbers.
        section : (3,) float, optional
            In 3-D: hide cells beyond the plane with this normal through the middle.

        Returns
        -------
        matplotlib.axes.Axes

        Raises
        ------
        OptionError
            Without matplotlib, or for invalid arguments.

        Examples
        --------
        >>> from agglo_core import samples
        >>> mesh = samples.squares(4).with_tags(rock=lambda x: x[:, 1] < 0.5)
        >>> ax = mesh.plot(values="rock")
        >>> [text.get_text() for text in ax.get_legend().get_texts()]
        ['0', '1']
        """
        return import_function("agglo_core.draw.on_axes:plot_mesh")(
            self, ax, values=values, cmap=cmap, section=section
        )

    def _repr_html_(self) -> str:
        html: str = import_function("agglo_core.draw.notebook:mesh_html")(self)
        return html
