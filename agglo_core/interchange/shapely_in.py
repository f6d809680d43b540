"""Convert shapely polygons to a mesh: rings of numbered vertices that are shared between neighbours."""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from typing import TYPE_CHECKING, Any, NamedTuple

import numpy as np
from numpy.typing import ArrayLike, NDArray

from agglo_core.arrays import Float, Int, frozen_float, frozen_int, trusted
from agglo_core.errors import MeshError
from agglo_core.mesh import Mesh
from agglo_core.mesh.checks import (
    check_extent,
    check_tags,
    compact_points,
    name_cells,
    note_repairs,
    warn_of_overlaps,
)
from agglo_core.mesh.construction.double_cover import warn_of_double_cover

if TYPE_CHECKING:
    from shapely import MultiPolygon, Polygon

_POLYGON, _MULTIPOLYGON = 3, 6  # shapely.GeometryType


class _Rings(NamedTuple):
    """Closed rings of vertices, oriented so that their cell lies on the left.

    Ring r of cell ``cells[r]`` is ``vertices[offsets[r]:offsets[r + 1]]``.
    """

    offsets: Int
    vertices: Int
    cells: Int

    @property
    def owners(self) -> Int:
        """Index of the ring to which each vertex belongs."""
        return frozen_int(np.repeat(np.arange(len(self.cells)), np.diff(self.offsets)))

    @property
    def followers(self) -> Int:
        """For each vertex the next vertex along its ring."""
        place = np.arange(1, len(self.vertices) + 1)
        place[self.offsets[1:] - 1] = self.offsets[:-1]
        return frozen_int(self.vertices[place])

    def with_vertices(self, vertices: ArrayLike, owners: ArrayLike) -> _Rings:
        """Replace all vertices of the rings, given the (ascending) ring index of each new vertex."""
        count = np.bincount(np.asarray(owners), minlength=len(self.cells))
        return _Rings(frozen_int(np.concatenate(([0], np.cumsum(count)))), frozen_int(vertices), self.cells)


def mesh_from_shapely(
    polygons: Iterable[Polygon | MultiPolygon],
    *,
    cell_tags: Mapping[str, ArrayLike] | None = None,
    tolerance: float = 0.0,
    strict: bool = False,
    name: str = "",
) -> Mesh:
    """Build a mesh whose cell i is polygon i, holes included.

    A MultiPolygon is one cell with several pieces, like a disconnected agglomerate in
    :func:`mesh_to_shapely`. To make each piece a cell, split first and keep its origin as a tag::

        pieces, item = shapely.get_parts(polygons, return_index=True)
        mesh = mesh_from_shapely(pieces, cell_tags={"item": item})

    Parameters
    ----------
    polygons : n polygons
        A list, an array, a geopandas column. Vertices with equal coordinates are merged; unlisted vertices
        on a neighbour's edge are inserted, and counted in ``repairs``.
    cell_tags : mapping of name to (n,) integers, optional
    tolerance : float
        Distance, in coordinate units, within which two vertices coincide, and a vertex lies on an edge.
        Rounding errors in the last few binary digits are always tolerated.
    strict : bool
        Also reject overlapping polygons, and narrow gaps beyond the tolerance.

    Raises
    ------
    MeshError
        With item numbers: not a polygon, empty, invalid (with shapely's reason), in 3-D, equal to another,
        an edge with more than two cells, a ring smaller than the tolerance.

    Examples
    --------
    >>> from shapely import box
    >>> agglo.interchange.mesh_from_shapely([box(0, 0, 1, 1), box(1, 0, 2, 1)])
    Mesh(2-D, 2 cells, 7 faces, 6 points)
    """
    items = _check_items(polygons)
    # Rings of points; nearly equal points merge, hanging vertices are inserted.
    points, rings = _rings(items)
    reach = max(float(tolerance), 16 * float(np.spacing(np.abs(points).max())))
    point_ids, vertices, _ = compact_points(points, rings.vertices, True)
    points, rings = frozen_float(points[point_ids]), rings._replace(vertices=vertices)
    rings, merged = _merge_near(points, rings, reach)
    rings, hanging = _insert_hanging(points, rings, reach)
    # Pair the half-edges of the rings.
    point_ids, vertices, _ = compact_points(points, rings.vertices, False)
    points, rings = frozen_float(points[point_ids]), rings._replace(vertices=vertices)
    face_vertices, face_cells, overlaps = _faces(rings, points, items)
    flat = np.flatnonzero(np.bincount(face_cells.ravel() + 1, minlength=len(items) + 1)[1:] == 0)
    if len(flat):
        raise MeshError(f"{name_cells(flat)}: nothing is left of it at the tolerance {reach:g}")
    repairs = {
        "close points merged": merged,
        "hanging vertices inserted": hanging,
        "overlapping edges left apart": overlaps,
    }
    mesh = trusted(
        Mesh,
        points=points,
        face_offsets=frozen_int(np.arange(0, 2 * len(face_cells) + 1, 2)),
        face_vertices=frozen_int(face_vertices.ravel()),
        face_cells=frozen_int(face_cells),
        cell_tags=check_tags("cell", cell_tags or {}, len(items)),
        repairs=note_repairs(repairs),
        name=name,
    )
    _check_result(mesh, strict)
    if not strict:
        warn_of_double_cover(mesh)
    return mesh


def _check_items(polygons: Any) -> NDArray[np.object_]:
    """Check that all items are valid, non-empty polygons, and return them as an object array."""
    import shapely

    if isinstance(polygons, shapely.Geometry):
        raise MeshError(
            f"expected a list of polygons, given one {polygons.geom_type}; call shapely.get_parts first"
        )
    items = np.fromiter(polygons, dtype=object)
    if not len(items):
        raise MeshError("the mesh is empty: no polygons were given")
    # Type, emptiness and validity of all items.
    non_geometries = np.flatnonzero(~shapely.is_geometry(items))
    if len(non_geometries):
        kind = type(items[non_geometries[0]]).__name__
        raise MeshError(f"{name_cells(non_geometries)}: expected shapely polygons, given {kind}")
    non_polygons = np.flatnonzero(~np.isin(shapely.get_type_id(items), (_POLYGON, _MULTIPOLYGON)))
    if len(non_polygons):
        kind = items[non_polygons[0]].geom_type
        raise MeshError(f"{name_cells(non_polygons)}: expected a Polygon or MultiPolygon, given a {kind}")
    empty = np.flatnonzero(shapely.is_empty(items))
    if len(empty):
        raise MeshError(f"{name_cells(empty)}: empty")
    invalid = np.flatnonzero(~shapely.is_valid(items))
    if len(invalid):
        reason = shapely.is_valid_reason(items[invalid[0]])
        raise MeshError(f"{name_cells(invalid)}: invalid, {reason}; shapely.make_valid may repair it")
    return items


def _rings(items: NDArray[np.object_]) -> tuple[Float, _Rings]:
    """Return the corner points and rings of all polygons: shells counter-clockwise, holes clockwise."""
    import shapely

    solid = shapely.has_z(items)
    if solid.any():
        z = shapely.get_coordinates(items[solid], include_z=True)[:, 2]
        if not np.ptp(z) == 0:  # NaN included
            raise MeshError(
                f"polygons in 3-D are a surface, which is not supported: z runs from {z.min():g} to "
                f"{z.max():g}; shapely.force_2d drops it"
            )
    check_extent(shapely.get_coordinates(items))
    tidy = shapely.orient_polygons(shapely.remove_repeated_points(items))
    parts, item = shapely.get_parts(tidy, return_index=True)
    loops, part = shapely.get_rings(parts, return_index=True)
    points, owner = shapely.get_coordinates(loops, return_index=True)
    inner = np.append(owner[1:] == owner[:-1], False)  # the last point of a ring repeats the first
    rings = _Rings(frozen_int([0]), frozen_int([]), frozen_int(item[part]))
    return frozen_float(points[inner]), rings.with_vertices(np.arange(inner.sum()), owner[inner])


def _merge_near(points: Float, rings: _Rings, reach: float) -> tuple[_Rings, int]:
    """Merge vertices closer than ``reach``, and return also the number of points removed."""
    from scipy.sparse import coo_array
    from scipy.sparse.csgraph import connected_components
    from scipy.spatial import cKDTree

    pairs = cKDTree(points).query_pairs(reach, output_type="ndarray")
    if not len(pairs):
        return rings, 0
    links = coo_array((np.ones(len(pairs)), pairs.T), shape=(len(points), len(points)))
    count, group = connected_components(links, directed=False)
    first = np.unique(group, return_index=True)[1]
    rings = rings._replace(vertices=frozen_int(first[group[rings.vertices]]))
    is_edge = rings.vertices != rings.followers
    rings = rings.with_vertices(rings.vertices[is_edge], rings.owners[is_edge])
    short = np.flatnonzero(np.diff(rings.offsets) < 3)
    if len(short):
        cells = np.unique(rings.cells[short])
        raise MeshError(f"{name_cells(cells)}: a ring is smaller than the tolerance {reach:g}")
    return rings, len(points) - int(count)


def _insert_hanging(points: Float, rings: _Rings, reach: float) -> tuple[_Rings, int]:
    """Insert neighbour vertices that lie on the edges of a ring (hanging vertices), and count them.

    Only edges that no neighbour traverses in the opposite direction can lack a vertex.
    """
    import shapely

    tail, head, n = rings.vertices, rings.followers, len(points)
    alone = np.flatnonzero(~np.isin(tail * n + head, head * n + tail))
    tree = shapely.STRtree(shapely.linestrings(np.stack((points[tail[alone]], points[head[alone]]), axis=1)))
    vertex, place = tree.query(shapely.points(points), predicate="dwithin", distance=reach)
    edge = alone[place]
    direction = points[head[edge]] - points[tail[edge]]
    projection = ((points[vertex] - points[tail[edge]]) * direction).sum(axis=1)
    inside = (
        (vertex != tail[edge])
        & (vertex != head[edge])
        & (projection > 0)
        & (projection < (direction**2).sum(axis=1))
    )
    order = np.flatnonzero(inside)[np.lexsort((projection[inside], edge[inside]))]
    vertices = np.insert(tail, edge[order] + 1, vertex[order])
    owners = np.insert(rings.owners, edge[order] + 1, rings.owners[edge[order]])
    return rings.with_vertices(vertices, owners), len(order)


def _faces(rings: _Rings, points: Float, items: NDArray[np.object_]) -> tuple[Int, Int, int]:
    """Match the edges of all rings, and return face vertices, face cells, and the overlap count."""
    import shapely

    from agglo_core.mesh.kernels.faces import match_half_edges

    face_vertices, face_rings, double, (a, b, *sharing) = match_half_edges(
        rings.offsets, rings.vertices, len(points)
    )
    if a >= 0:
        raise MeshError(
            f"{name_cells(np.unique(rings.cells[sharing]))} overlap: more than two cells share the edge "
            f"from {points[a].tolist()} to {points[b].tolist()}"
        )
    pairs = rings.cells[double]
    equal = np.flatnonzero(shapely.equals(items[pairs[:, 0]], items[pairs[:, 1]]))
    if len(equal):
        raise MeshError(f"{name_cells(pairs[equal[0]])} are the same polygon")
    warn_of_overlaps(pairs)
    face_cells = np.append(rings.cells, -1)[face_rings]
    is_face = face_cells[:, 0] != face_cells[:, 1]  # rings of one cell closer than the tolerance
    return frozen_int(face_vertices[is_face]), frozen_int(face_cells[is_face]), len(double)


def _check_result(mesh: Mesh, strict: bool) -> None:
    """Raise MeshError if a cell has no area or, if ``strict``, overlaps another cell."""
    flat = np.flatnonzero(~(mesh.cell_measures > 0))
    if len(flat):
        raise MeshError(f"{name_cells(flat)}: zero area")
    if not strict:
        return
    import shapely

    from agglo_core.interchange.shapely_out import mesh_to_shapely

    wrong = shapely.coverage_invalid_edges(mesh_to_shapely(mesh))
    cells = np.flatnonzero(~shapely.is_empty(wrong))
    if len(cells):
        a, b = shapely.get_coordinates(wrong[cells[0]])[:2].tolist()
        raise MeshError(
            f"{name_cells(cells)}: an overlap or a narrow gap with a neighbour, "
            f"first along the edge from {a} to {b} of cell {cells[0]}"
        )
