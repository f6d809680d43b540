"""Quality metrics with one value per agglomerate: diameters, inscribed circles and graph cuts.

``J`` and ``isoperimetric`` are in ``round_shapes``. ``convexity``, ``star_shapedness`` and the ratios for
boxes, edges and faces are in ``shape_metrics``.

A metric with ``shape_only = True`` depends only on the agglomerates, not on the cells inside: on the coarse
mesh, with one label per cell, its values are equal. :func:`agglo_core.quality` coarsens once, and all these
metrics share the coarse mesh and its caches.
"""

from __future__ import annotations

from math import inf
from typing import Literal
from weakref import WeakKeyDictionary

import numpy as np

from agglo_core.arrays import Float, Int
from agglo_core.errors import MeshError, OptionError
from agglo_core.graph import Graph, functionals, moves
from agglo_core.mesh import Mesh
from agglo_core.shapes.solid_shapes import ball_radii
from agglo_core.threads import over_ranges

# Minimum number of agglomerates for a thread: their circles take some ten milliseconds
# (benchmarks/threads.py).
_FEW = 500

_CIRCLES: WeakKeyDictionary[Mesh, Float] = WeakKeyDictionary()  # shared by CR and CRc

Better = Literal["high", "low"]


def agglomerates(mesh: Mesh, labels: Int) -> Mesh:
    """Return the mesh of agglomerates, or ``mesh`` itself if cell i has label i for every i."""
    labels = mesh.check_labels(labels)
    if labels[-1] == mesh.n_cells - 1 and np.array_equal(labels, np.arange(mesh.n_cells)):
        return mesh
    return mesh.coarsen(labels)


def plane_agglomerates(mesh: Mesh, labels: Int, metric: str) -> Mesh:
    """Return the mesh of agglomerates for a 2-D metric, or raise MeshError in 3-D."""
    if mesh.dim != 2:
        raise MeshError(f"metric {metric} exists only for 2-D meshes; this one is {mesh.dim}-D")
    return agglomerates(mesh, labels)


def _ball_ratios(mesh: Mesh, labels: Int, anywhere: bool) -> Float:
    """Return the ratio of the largest inscribed circle (3-D: ball) radius to half the diameter ``(k,)``."""
    coarse = agglomerates(mesh, labels)
    radii = (
        _circle_radii(coarse)[:, 0 if anywhere else 1] if coarse.dim == 2 else ball_radii(coarse, anywhere)
    )
    ratios: Float = 2.0 * radii / coarse.cell_diameters
    return ratios


def _circle_radii(mesh: Mesh) -> Float:
    """Return the radii ``(n_cells, 2)`` of the largest circle inside each cell: anywhere, at the centroid.

    They are computed once per mesh.
    """
    from agglo_core.shapes.circle import circles

    if mesh in _CIRCLES:
        return _CIRCLES[mesh]
    points, (first, *loops) = mesh.local_points, mesh.boundary_loops
    centroids, diameters = mesh.local_centroids, mesh.cell_diameters

    def radii(start: int, stop: int) -> Float:
        span = slice(start, stop)
        result: Float = circles(points, first[start : stop + 1], *loops, centroids[span], diameters[span])
        return result

    _CIRCLES[mesh] = np.concatenate(over_ranges(radii, mesh.n_cells, few=_FEW))
    return _CIRCLES[mesh]


class UniformityFactor:
    """Uniformity factor diam(P) / h, with h the largest diameter in the partition (paper, §4)."""

    better: Better = "high"
    bounds = (0.0, 1.0)
    homogeneity = 0
    shape_only = True
    relative = True

    def measure(self, mesh: Mesh, labels: Int) -> Float:
        """Return the uniformity factors ``(k,)``."""
        diameters: Float = agglomerates(mesh, labels).cell_diameters
        factors: Float = diameters / diameters.max()
        return factors


class UniformityFactor99:
    """Diameter over the 99th percentile of all diameters, robust against single outliers."""

    better: Better = "high"
    bounds = (0.0, inf)
    homogeneity = 0
    shape_only = True
    relative = True

    def measure(self, mesh: Mesh, labels: Int) -> Float:
        """Return the diameters over their 99th percentile ``(k,)``, above 1 for the largest hundredth."""
        diameters: Float = agglomerates(mesh, labels).cell_diameters
        return diameters / np.percentile(diameters, 99)


class CircleRatio:
    """Circle ratio: radius of the largest inscribed circle (3-D: ball) over half the diameter (paper, §4)."""

    better: Better = "high"
    bounds = (0.0, 1.0)
    homogeneity = 0
    shape_only = True

    def measure(self, mesh: Mesh, labels: Int) -> Float:
        """Return the circle ratios ``(k,)``.

        The radius is at most 1e-5 (3-D: 1e-3) of itself below the maximum.
        """
        return _ball_ratios(mesh, labels, anywhere=True)


class CentredCircleRatio:
    """Circle ratio for the circle (ball) about the centroid, 0 for an outside centroid (paper's tables)."""

    better: Better = "high"
    bounds = (0.0, 1.0)
    homogeneity = 0
    shape_only = True

    def measure(self, mesh: Mesh, labels: Int) -> Float:
        """Return the ratios for the circle about the centroid ``(k,)``."""
        return _ball_ratios(mesh, labels, anywhere=False)


class DiameterRatio:
    """Diameter of the agglomerate over a requested size.

    Parameters
    ----------
    h_star : float
        Positive, in mesh units. As it is fixed, values scale like a length.

    Raises
    ------
    OptionError
        If ``h_star`` is not a positive, finite number.
    """

    better: Better = "low"
    bounds = (0.0, inf)
    homogeneity = 1
    shape_only = True

    def __init__(self, h_star: float) -> None:
        number = isinstance(h_star, int | float | np.number) and not isinstance(h_star, bool)
        if not number or not 0.0 < h_star < inf:
            raise OptionError(f"diameter_ratio: h_star must be a positive, finite number, not {h_star!r}")
        self.h_star = float(h_star)

    def measure(self, mesh: Mesh, labels: Int) -> Float:
        """Return diam(P) / h_star ``(k,)``."""
        return agglomerates(mesh, labels).cell_diameters / self.h_star


class InterfaceLength:
    """Measure of the faces shared with other agglomerates: a length in 2-D, an area (L²) in 3-D."""

    better: Better = "low"
    bounds = (0.0, inf)
    homogeneity = 1
    shape_only = True

    def measure(self, mesh: Mesh, labels: Int) -> Float:
        """Return the measure of each agglomerate's interfaces ``(k,)``, without the domain boundary."""
        coarse = agglomerates(mesh, labels)
        inner = coarse.face_cells[:, 1] >= 0
        pairs, measures = coarse.face_cells[inner], coarse.face_measures[inner]
        lengths = np.bincount(pairs.ravel(), np.repeat(measures, 2), minlength=coarse.n_cells)
        return lengths.astype(float)  # without inner faces numpy returns integers

    def changes(self, graph: Graph, labels: Int, cells: Int, parts: Int) -> Float:
        """Return the change ``(q,)`` in the sum of the metric over all parts for each single-cell move.

        A face between parts counts for both.
        """
        return 2.0 * moves.interface_changes(graph, labels, cells, parts)


class Cut:
    """Number of dual edges that leave the agglomerate: cut(S_k, V∖S_k) (paper, §2.1)."""

    better: Better = "low"
    bounds = (0.0, inf)
    homogeneity = 0

    def measure(self, mesh: Mesh, labels: Int) -> Float:
        """Return the numbers of cut edges ``(k,)``, where each edge counts for both its parts."""
        return functionals.part_cuts(mesh.graph, mesh.check_labels(labels))

    def changes(self, graph: Graph, labels: Int, cells: Int, parts: Int) -> Float:
        """Return the change ``(q,)`` in the sum of the metric over all parts for each single-cell move.

        An edge between parts counts for both.
        """
        return 2.0 * moves.cut_changes(graph, labels, cells, parts)


class NormalisedCut:
    """Cut edges over the volume, the total degree of the cells: cut / vol (paper, §2.1)."""

    better: Better = "low"
    bounds = (0.0, 1.0)
    homogeneity = 0

    def measure(self, mesh: Mesh, labels: Int) -> Float:
        """Return cut(S_k, V∖S_k) / vol(S_k, V) ``(k,)``, 0 for a cell without neighbours."""
        parts = mesh.check_labels(labels)
        cuts = functionals.part_cuts(mesh.graph, parts)
        return functionals.ratio(cuts, functionals.part_volumes(mesh.graph, parts))

    def changes(self, graph: Graph, labels: Int, cells: Int, parts: Int) -> Float:
        """Return the change ``(q,)`` in the sum of the metric over all parts for each single-cell move."""
        return moves.normalised_cut_changes(graph, labels, cells, parts)


class Components:
    """Number of connected components, where cells are connected through faces."""

    better: Better = "low"
    bounds = (1.0, inf)
    homogeneity = 0

    def measure(self, mesh: Mesh, labels: Int) -> Float:
        """Return the numbers of connected components ``(k,)``, 1 for connected agglomerates."""
        from agglo_core.shapes.connected import count_components

        parts = mesh.check_labels(labels)
        found: Float = count_components(mesh.face_cells, parts, int(parts.max()) + 1).astype(float)
        return found


class Cells:
    """Number of cells in the agglomerate: the coarsening ratio."""

    better: Better = "high"
    bounds = (1.0, inf)
    homogeneity = 0

    def measure(self, mesh: Mesh, labels: Int) -> Float:
        """Return the cell counts ``(k,)``."""
        return np.bincount(mesh.check_labels(labels)).astype(float)
