"""Mesh: points, faces and the two cells beside each face. Everything else is derived."""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, field
from functools import cached_property
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from agglo_core.arrays import FieldState, Float, Int, frozen, owned, trusted, trusted_copy
from agglo_core.errors import OptionError
from agglo_core.mesh.checks import check_faces, check_points, check_tags, note_repairs, whole_numbers
from agglo_core.mesh.coarsening import coarse_faces, surviving_tags
from agglo_core.mesh.construction.closed_cells import check_cells
from agglo_core.mesh.construction.conforming import TOLERANCE, join_outer_faces
from agglo_core.mesh.construction.double_cover import warn_of_double_cover
from agglo_core.mesh.construction.polygons import Faces, build_polygons
from agglo_core.mesh.construction.polyhedra import build_polyhedra
from agglo_core.mesh.derived import Derived
from agglo_core.mesh.elsewhere import made_by
from agglo_core.mesh.renumbering import renumbered_arrays
from agglo_core.mesh.simplify.edges import MAX_TOLERANCE, fewer_edges
from agglo_core.mesh.simplify.patches import fewer_faces
from agglo_core.mesh.simplify.record import Simplification, recorded
from agglo_core.mesh.tagging import Tagged

if TYPE_CHECKING:
    from agglo_core.graph import Graph


@dataclass(frozen=True, eq=False)
class Mesh(FieldState, Derived, Tagged):
    """A polygonal (d = 2) or polyhedral (d = 3) mesh, face by face.

    Build one with :meth:`from_polygons`, :meth:`from_polyhedra`, :func:`agglo_core.read` or
    :mod:`agglo_core.samples`, or face by face from the arrays below, which are copied unless nobody can
    write to them. An agglomerate is just a bigger cell, so :meth:`coarsen` gives a Mesh again.

    Attributes
    ----------
    points : (n_points, d) float
        Vertex coordinates.
    face_offsets : (n_faces + 1,) int
        Face f has the vertices ``face_vertices[face_offsets[f]:face_offsets[f + 1]]``.
    face_vertices : (v,) int
        In 2-D two per face, the owner on the left; in 3-D counter-clockwise seen from outside the owner.
    face_cells : (n_faces, 2) int
        Owner and neighbour cell; −1 is outside the domain.
    cell_tags, face_tags : mapping of name to (n_cells,) or (n_faces,) int
        Materials, boundary patches.
    repairs : mapping of text to count
        What was normalised when the mesh was built.
    name : str
        For reports.
    simplification : Simplification, optional
        What :meth:`simplified` changed, if the mesh was made by it.

    Raises
    ------
    MeshError
        If the arrays do not have these shapes or hold masked entries, points that are not finite, fractions
        or numbers out of range; if cells have no faces, faces that do not close, or no positive measure.
        Cells that cross themselves or overlap are refused by :meth:`from_polygons` alone.
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
        """Raise MeshError unless the arrays form a mesh: what the constructor checks."""
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
        """Mesh from polygons given as vertex loops.

        Overlapping cells are left as they are, with a warning: by how much their total measure exceeds the
        measure of their union. It costs some per cent of the construction, as only outer faces are examined.

        Parameters
        ----------
        points : (n_points, 2) float
            Coordinates; a third column is accepted if it is constant.
        cells : list of index loops, (n, k) integers, or a tuple of two 1-D arrays (offsets, vertices)
            Loops in either direction (clockwise ones are reversed and counted). A vertex that follows
            itself, as in closed and padded loops, counts once. Masked entries at the end of a row are
            padding.
        cell_tags : mapping of name to (n,) integers, optional
        merge_points : bool, optional
            True merges all exactly equal points first, False merges no points at all. By default points
            at one place are merged where outer edges lie on one another, as :meth:`conforming` does.
        allow_gaps : bool
            Leave outer edges that lie on one another as they are: a crack, bodies that touch. By default
            they are joined, and vertices that hang on a neighbour's edge are inserted there.
        drop_flat : bool
            Leave out cells of zero area or volume; the others are numbered anew, in their order.
        weak : bool
            Accept polygons that touch themselves; an edge traversed both ways is a bridge to a hole
            and is dropped.
        strict : bool
            Also refuse cells that overlap and vertices that lie unlisted on a neighbour's edge.

        Raises
        ------
        MeshError
            Naming cells or faces: non-finite coordinates, too few vertices, a vertex met again, zero area,
            self-intersection, duplicates, more than two cells on a face, no cells, a surface in 3-D, masked
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
        """Mesh from polyhedra given as lists of faces (vertex loops).

        Cells that overlap without sharing a face are not found, other than by :meth:`from_polygons`.

        Parameters
        ----------
        points : (n_points, 3) float
        cells : list of cells, each a list of loops; or (cell_offsets, loop_offsets, vertices)
            Cell c owns loops ``cell_offsets[c]:cell_offsets[c + 1]``, each in either direction. Shells
            inside a shell bound cavities. Faces that repeated vertices leave without area are dropped.
        cell_tags, merge_points, allow_gaps, drop_flat, name
            As in :meth:`from_polygons`.

        Raises
        ------
        MeshError
            Naming cells or faces, as in :meth:`from_polygons`; also a cell whose faces do not close, and
            outer faces that overlap in part (unless ``allow_gaps=True``).
        """
        mesh = cls._of(*build_polyhedra(points, cells, bool(merge_points), drop_flat), cell_tags, name)
        return mesh if allow_gaps else mesh.conforming(merge_points=merge_points is not False)

    @classmethod
    def _of(cls, faces: Faces, own: Int, n: int, given: Mapping[str, ArrayLike] | None, name: str) -> Mesh:
        tags = check_tags("cell", given or {}, n)
        if len(own) < n:
            tags = {key: frozen(values[own], values.dtype) for key, values in tags.items()}
        return trusted(cls, **faces._asdict(), cell_tags=tags, name=name)

    @cached_property
    def graph(self) -> Graph:
        """Dual graph: one node per cell, one edge per pair of neighbours."""
        from agglo_core.graph import dual_graph

        return dual_graph(self)

    def __repr__(self) -> str:
        name = f"{self.name!r}, " if self.name else ""
        return f"Mesh({name}{self.dim}-D, {self.n_cells} cells, {self.n_faces} faces, {self.n_points} points)"

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
        faces = left.offsets, left.vertices, left.cells
        cell_tags = surviving_tags(self.cell_tags, labels)
        face_tags = {name: values[left.kept] for name, values in self.face_tags.items()}
        return trusted(Mesh, self.points, *faces, cell_tags, face_tags, name=self.name)

    def conforming(self, *, tolerance: float = TOLERANCE, merge_points: bool = True) -> Mesh:
        """This mesh with outer faces that lie on one another joined; itself if there are none.

        In 2-D every vertex that lies on the interior of a neighbour's outer edge is inserted there, so that
        cells of different size are neighbours. Points at one place become one where a face is joined.
        Cells keep their numbers. Both parts of a split face have its tags; a joined face has those of
        the first of the two, where that is −1 those of the other. Everything is counted in ``repairs``.
        What lies on one another without fitting (cells that overlap) is left apart with a warning.

        Building and reading meshes does this by itself unless told ``allow_gaps=True``.

        Parameters
        ----------
        tolerance : float
            How far from one another faces may lie, relative to length and height of the smaller cell
            there. The default leaves room for rounding and is far below any gap that is meant;
            coordinates with few digits may need more.
        merge_points : bool
            Whether points at one place are merged; otherwise only faces that have the same points once
            vertices are inserted are joined.

        Raises
        ------
        OptionError
            If the tolerance is not a number from 0 to 0.01.
        MeshError
            In 3-D for outer faces that overlap in part, naming cells: they are not split.

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
        found = join_outer_faces(self, tolerance, merge_points)
        if found is None:
            return self
        points, offsets, vertices, cells, (first, second), repairs = found
        tags = {
            name: np.where(values[first] == -1, values[second], values[first])
            for name, values in self.face_tags.items()
        }
        known = {**self.repairs, **note_repairs(repairs)}
        return trusted(Mesh, points, offsets, vertices, cells, self.cell_tags, tags, known, self.name)

    def simplified(self, tolerance: float = 0.0) -> Mesh:
        """This mesh with fewer faces: straight runs of edges between the same two cells as one edge.

        In 3-D flat patches of faces become one face, if it is a single loop. Nothing but rounding changes.
        With a tolerance (2-D) interfaces are straightened: vertices at which nothing else ends go if they are
        within that part of the diameter of the smaller cell from the new edge. The boundary of the domain
        stays, and so does the total measure. Cells stay polygons without crossings and keep half their
        measure: interfaces that would break that keep more vertices. Such a mesh is no coarsening of the one
        before, and says so: ``simplification.exact`` is False.

        Faces with different tags stay apart. Cells keep their numbers, points and faces get new ones:
        ``simplification`` has the old ones, counts, and the change of each cell's measure.

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
                    f"simplified: in 3-D only flat patches become one face, tolerance=0; given {tolerance!r}"
                )
            fewer = fewer_faces(self, self.face_tags)
        else:
            fewer = fewer_edges(self, self.face_tags, tolerance)
        faces = fewer.face_offsets, fewer.face_vertices, self.face_cells[fewer.leads]
        tags = {name: values[fewer.leads] for name, values in self.face_tags.items()}
        moved = f"faces fewer, interfaces moved within {tolerance:g} of the cells"
        saved = {moved if tolerance else "straight faces joined": self.n_faces - len(fewer.leads)}
        known = {**self.repairs, **note_repairs(saved)}
        made = trusted(Mesh, self.points[fewer.points], *faces, self.cell_tags, tags, known, self.name)
        return trusted_copy(made, simplification=recorded(self, made, fewer, tolerance))

    def renumbered(self, cells: ArrayLike) -> Mesh:
        """This mesh with its cells in another order, faces as the cells meet them, points as the faces do.

        Tags go with cells and faces; points that no face has are left out.

        Parameters
        ----------
        cells : (n_cells,) int
            The cell of this mesh that becomes cell 0, 1, ….

        Raises
        ------
        MeshError
            If it does not hold each cell once.
        """
        new = renumbered_arrays(self, cells)
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
        """Make a mesh whose cell i is polygon i; see :func:`agglo_core.interchange.mesh_from_shapely`."""
        from agglo_core.interchange import mesh_from_shapely

        return mesh_from_shapely(polygons, cell_tags=cell_tags, tolerance=tolerance, strict=strict, name=name)

    def to_shapely(self) -> NDArray[np.object_]:
        """Each cell as a valid Polygon or MultiPolygon ``(n_cells,)``, holes and pinches included."""
        from agglo_core.interchange import mesh_to_shapely

        return mesh_to_shapely(self)

    def to_pyvista(self, hierarchy: Any = None) -> Any:
        """``pyvista.UnstructuredGrid`` with tags, and labels of every level of a hierarchy, as cell data."""
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
