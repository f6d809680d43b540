"""Shape metrics of agglomerates: 1 is best, 0 worst, independent of the cells inside.

M. Attene et al., "Benchmark of polygon quality metrics for polytopal element methods" (2019) compares area to
perimeter, kernel to area, and shortest to longest edge. Convexity and bounding-box side ratios are also
common.
"""

from __future__ import annotations

from typing import Literal

import numpy as np

from agglo_core.arrays import Float, Int, frozen_float, frozen_int
from agglo_core.mesh import Loops, Mesh
from agglo_core.shapes import solid_shapes
from agglo_core.shapes.metrics import agglomerates, plane_agglomerates
from agglo_core.threads import COSTLY, over_ranges

_STRAIGHT = 1e-8  # radians; rounding of coordinates bends collinear edges by less


Better = Literal["high", "low"]


class Convexity:
    """Area (3-D: volume) over convex hull area (volume), 1 for convex agglomerates."""

    better: Better = "high"
    bounds = (0.0, 1.0)
    homogeneity = 0
    shape_only = True

    def measure(self, mesh: Mesh, labels: Int) -> Float:
        """Return the convexity ``(k,)``."""
        coarse = agglomerates(mesh, labels)
        hulls = _hulls(coarse)[0] if coarse.dim == 2 else solid_shapes.hull_volumes(coarse)
        return np.minimum(coarse.cell_measures / hulls, 1.0)  # rounding may exceed 1


class StarShapedness:
    """Area (3-D: volume) of the kernel of star-shapedness over total area (volume).

    The kernel is the set of points that see the whole agglomerate. The value is 0 for agglomerates that are
    not star-shaped, for example due to holes, cavities, loose parts or parts that only touch.
    """

    better: Better = "high"
    bounds = (0.0, 1.0)
    homogeneity = 0
    shape_only = True

    def measure(self, mesh: Mesh, labels: Int) -> Float:
        """Return the star-shapedness ``(k,)``."""
        coarse = agglomerates(mesh, labels)
        seeing = _sight_areas(coarse) if coarse.dim == 2 else solid_shapes.sight_volumes(coarse)
        shares: Float = np.clip(seeing / coarse.cell_measures, 0.0, 1.0)  # rounding may exceed the bounds
        return shares


class BoxRatio:
    """Short over long side of the narrowest enclosing rectangle (3-D: box), in any direction.

    The narrowest rectangle, not the rectangle of least area, because the latter is not unique (for an acute
    triangle the boxes on all three sides have equal area), so rounding would decide the ratio. Among equally
    narrow rectangles the shortest counts. The narrowest box has two sides as close to each other as possible,
    and the narrowest rectangle around the projection along them. The ratio is the shortest side over the
    longest.
    """

    better: Better = "high"
    bounds = (0.0, 1.0)
    homogeneity = 0
    shape_only = True

    def measure(self, mesh: Mesh, labels: Int) -> Float:
        """Return the box ratios ``(k,)``."""
        coarse = agglomerates(mesh, labels)
        ratios = _rectangles(coarse) if coarse.dim == 2 else solid_shapes.narrowest_boxes(coarse)
        return np.minimum(ratios, 1.0)


class EdgeRatio:
    """Length ratio of the shortest to the longest straight boundary edge.

    Collinear fine edges (bent by less than 1e-8 rad) count as one edge, so that the value describes the
    agglomerate and not the cells along its boundary. Inner boundaries also count.
    """

    better: Better = "high"
    bounds = (0.0, 1.0)
    homogeneity = 0
    shape_only = True

    def measure(self, mesh: Mesh, labels: Int) -> Float:
        """Return the edge ratios ``(k,)``, 2-D only: see :class:`FaceRatio`."""
        return _edge_ratios(plane_agglomerates(mesh, labels, "edge_ratio"))


class FaceRatio:
    """Area ratio of the smallest to the largest flat boundary face (``edge_ratio`` in 2-D).

    Coplanar fine faces with a common edge (tilted by less than 1e-8 rad) count as one face. Inner boundaries
    also count. Non-flat cell faces count as their triangles.
    """

    better: Better = "high"
    bounds = (0.0, 1.0)
    homogeneity = 0
    shape_only = True

    def measure(self, mesh: Mesh, labels: Int) -> Float:
        """Return the face ratios ``(k,)``."""
        coarse = agglomerates(mesh, labels)
        return _edge_ratios(coarse) if coarse.dim == 2 else solid_shapes.face_area_ratios(coarse)


def _edge_ratios(mesh: Mesh) -> Float:
    """Return the ratio of the shortest to the longest straight edge of each cell ``(n_cells,)``."""
    corners = _corners(mesh)
    lengths = np.hypot(*_edges(mesh.local_points, corners))
    starts = corners.loop_offsets[corners.cell_offsets[:-1]]
    shortest, longest = np.minimum.reduceat(lengths, starts), np.maximum.reduceat(lengths, starts)
    ratios: Float = shortest / longest
    return ratios


def _sight_areas(mesh: Mesh) -> Float:
    """Return the areas ``(n_cells,)`` of the kernels: the points from which the whole cell is visible."""
    from agglo_core.shapes.planar_shapes import kernel_areas

    points, (first, *loops) = mesh.local_points, mesh.boundary_loops
    _, offsets, hulls = _hulls(mesh)

    def kernels(start: int, stop: int) -> Float:
        own = slice(start, stop + 1)
        found: Float = kernel_areas(points, first[own], *loops, offsets[own], hulls)
        return found

    return np.concatenate(over_ranges(kernels, mesh.n_cells, few=COSTLY))


def _rectangles(mesh: Mesh) -> Float:
    """Return the ratio of short to long side ``(n_cells,)`` of the narrowest rectangle around each cell."""
    from agglo_core.shapes.planar_shapes import box_ratios

    points, (_, offsets, hulls) = mesh.local_points, _hulls(mesh)

    def narrowest(start: int, stop: int) -> Float:
        found: Float = box_ratios(points, offsets[start : stop + 1], hulls)
        return found

    return np.concatenate(over_ranges(narrowest, mesh.n_cells, few=COSTLY))


def _hulls(mesh: Mesh) -> tuple[Float, Int, Int]:
    """Return the convex hull areas ``(n_cells,)``, and the hull vertices as CSR, counter-clockwise."""
    from agglo_core.shapes.planar_shapes import convex_hulls

    points, (corners, vertices) = mesh.local_points, mesh.cell_vertices

    def hulls(start: int, stop: int) -> tuple[Float, Int, Int]:
        first, last = corners[start], corners[stop]
        row_offsets = frozen_int(corners[start : stop + 1] - first)
        found: tuple[Float, Int, Int] = convex_hulls(points, row_offsets, vertices[first:last])
        return found

    areas, offsets, found = zip(*over_ranges(hulls, mesh.n_cells, few=COSTLY), strict=True)
    sizes = np.concatenate([np.diff(o) for o in offsets])
    ends = frozen_int(np.concatenate(([0], np.cumsum(sizes))))
    return frozen_float(np.concatenate(areas)), ends, frozen_int(np.concatenate(found))


def _edges(points: Float, loops: Loops) -> tuple[Float, Float]:
    """Return the components ``(n,)`` of the vectors from each loop vertex to the next."""
    following = np.append(loops.vertices[1:], 0)
    following[loops.loop_offsets[1:] - 1] = loops.vertices[loops.loop_offsets[:-1]]
    x, y = points.T
    return x[following] - x[loops.vertices], y[following] - y[loops.vertices]


def _corners(mesh: Mesh) -> Loops:
    """Return the boundary loops of all cells, without vertices where the boundary is straight."""
    loops = mesh.boundary_loops
    x, y = _edges(mesh.local_points, loops)
    before = np.arange(-1, len(x) - 1)
    before[loops.loop_offsets[:-1]] = loops.loop_offsets[1:] - 1
    cross, dot = x[before] * y - y[before] * x, x[before] * x + y[before] * y
    corner = np.abs(cross) > _STRAIGHT * dot
    kept = np.append(0, np.cumsum(corner))
    return Loops(loops.cell_offsets, kept[loops.loop_offsets], loops.vertices[corner])
