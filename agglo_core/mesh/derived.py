"""Quantities derived from mesh arrays, each computed once: sizes, measures, centroids, loops."""

from __future__ import annotations

import hashlib
from collections.abc import Mapping
from functools import cached_property
from typing import Any

import numpy as np
from numpy.typing import ArrayLike

from agglo_core.arrays import Float, Int, Mask, frozen, frozen_float, frozen_index, frozen_int, narrow
from agglo_core.errors import MeshError
from agglo_core.mesh.checks import box_centre, check_labels
from agglo_core.mesh.geometry.diameters import diameters_of
from agglo_core.mesh.geometry.inertia import plane_inertias, polyhedron_inertias
from agglo_core.mesh.geometry.loops import Loops, faces_of_cells, loops_of_cells
from agglo_core.mesh.geometry.plane_cells import Neighbours, PlaneCells, plane_cells
from agglo_core.mesh.geometry.solid_cells import face_moments, polyhedron_moments, polyhedron_vertices


class Derived:
    """Base class of :class:`~agglo_core.mesh.Mesh`: quantities computed on first access."""

    points: Float
    face_offsets: Int
    face_vertices: Int
    face_cells: Int
    repairs: Mapping[str, int]

    # -- sizes ---------------------------------------------------------------------------------
    @property
    def dim(self) -> int:
        """Space dimension d, 2 or 3."""
        return int(self.points.shape[1])

    @property
    def n_points(self) -> int:
        """Point count."""
        return len(self.points)

    @property
    def n_faces(self) -> int:
        """Face count (edges in 2-D)."""
        return len(self.face_cells)

    @cached_property
    def n_cells(self) -> int:
        """Cell count."""
        return int(self.face_cells.max(initial=-1)) + 1

    # -- geometry ------------------------------------------------------------------------------
    @cached_property
    def origin(self) -> Float:
        """Bounding-box centre ``(d,)``, the origin of local coordinates."""
        used = np.zeros(self.n_points, bool)
        used[self.face_vertices] = True
        return box_centre(self.points if used.all() else self.points[used])

    @cached_property
    def outer_faces(self) -> Mask:
        """Mask of the faces on the domain boundary ``(n_faces,)``.

        These are the faces with one cell. In a rank's part of a larger mesh they are on the boundary of the
        larger mesh.
        """
        return frozen(self.face_cells[:, 1] < 0, np.bool_)

    @cached_property
    def local_points(self) -> Float:
        """Points relative to :attr:`origin`, so that meshes far from 0 lose no digits."""
        return frozen_float(self.points - self.origin)

    @cached_property
    def cell_faces(self) -> tuple[Int, Int]:
        """Faces per cell as CSR: offsets ``(n_cells + 1,)`` and face indices."""
        return faces_of_cells(self.face_cells, self.n_cells)

    @cached_property
    def _moments(self) -> tuple[Float, Float]:
        if self.dim == 3:
            return polyhedron_moments(*self._face_moments, self.face_cells, *self.cell_faces)
        return self._plane.measures, self._plane.centroids

    @cached_property
    def _plane(self) -> PlaneCells:
        return plane_cells(self.local_points, self.face_pairs, self.face_cells, self.n_cells)

    @cached_property
    def _face_moments(self) -> tuple[Float, Float]:
        return face_moments(self.local_points, self.face_offsets, self.face_vertices)

    @cached_property
    def _face_vectors(self) -> Float:
        """Area vectors ``(n_faces, d)``: unit normals times measures, outward from the owner cell."""
        if self.dim == 3:
            return self._face_moments[0]
        ends = self.local_points.take(self.face_pairs, axis=0)  # ten times faster than indexing
        edge = ends[:, 1] - ends[:, 0]
        return frozen_float(np.stack((edge[:, 1], -edge[:, 0]), axis=1))

    @property
    def face_pairs(self) -> Int:
        """The two vertices of each face of a 2-D mesh ``(n_faces, 2)``.

        Raises
        ------
        MeshError
            In 3-D, where the vertex count varies.
        """
        if self.dim != 2:
            raise MeshError("face_pairs exists only for 2-D meshes; use face_offsets and face_vertices")
        return self.face_vertices.reshape(-1, 2)

    @property
    def cell_measures(self) -> Float:
        """Areas or volumes ``(n_cells,)`` by the divergence theorem, exact for any shape."""
        return self._moments[0]

    @property
    def local_centroids(self) -> Float:
        """Cell centroids relative to :attr:`origin` ``(n_cells, d)``."""
        return self._moments[1]

    @cached_property
    def cell_centroids(self) -> Float:
        """Cell centroids ``(n_cells, d)``."""
        return frozen_float(self.local_centroids + self.origin)

    @cached_property
    def cell_inertias(self) -> Float:
        """Moments of inertia ``∫ |x − C|²`` per cell about its centroid C ``(n_cells,)``, exact."""
        if self.dim == 2:
            return plane_inertias(
                self.local_points, self.face_pairs, self.face_cells, *self.cell_faces, self.local_centroids
            )
        loops = self.local_points, self.face_offsets, self.face_vertices, *self._face_moments
        return polyhedron_inertias(*loops, self.face_cells, *self.cell_faces, self.local_centroids)

    @cached_property
    def face_measures(self) -> Float:
        """Face lengths or areas ``(n_faces,)``."""
        return frozen_float(np.linalg.norm(self._face_vectors, axis=1))

    @cached_property
    def face_centroids(self) -> Float:
        """Face centroids ``(n_faces, d)``, in 2-D the edge midpoints."""
        if self.dim == 3:
            return frozen_float(self._face_moments[1] + self.origin)
        return frozen_float(self.points.take(self.face_pairs, axis=0).mean(axis=1))

    @cached_property
    def face_normals(self) -> Float:
        """Unit normals ``(n_faces, d)``, outward from the owner cell.

        Faces without measure have 0.
        """
        length = self.face_measures[:, None]
        return frozen_float(self._face_vectors / np.where(length > 0, length, 1.0))

    @cached_property
    def cell_vertices(self) -> tuple[Int, Any]:
        """Vertices per cell as CSR (offsets int64, vertices int32), in arbitrary order."""
        if self.dim == 3:
            faces = self.cell_faces
            return polyhedron_vertices(self.face_offsets, self.face_vertices, *faces, self.n_points)
        return self._plane.vertex_offsets, self._plane.vertices

    @cached_property
    def cell_neighbours(self) -> Neighbours:
        """Cells with common faces as CSR, and the measures of these faces."""
        if self.dim == 2:
            return self._plane.neighbours
        from agglo_core.compiled.graphs import dual_graph

        indptr, indices, interface, boundary = dual_graph(
            *self.cell_faces, self.face_cells, self.face_measures
        )
        return Neighbours(
            frozen_int(indptr), frozen_index(indices), frozen_float(interface), frozen_float(boundary)
        )

    @cached_property
    def cell_diameters(self) -> Float:
        """Largest vertex distance per cell ``(n_cells,)``."""
        cells = frozen_int(np.arange(self.n_cells + 1))
        return diameters_of(cells, cells, *self.cell_vertices, self.local_points)

    @property
    def h(self) -> float:
        """Mesh size: the largest cell diameter (paper, §2.2)."""
        return float(self.cell_diameters.max())

    @cached_property
    def boundary_loops(self) -> Loops:
        """Boundary of each cell of a 2-D mesh as closed vertex loops.

        Raises
        ------
        MeshError
            In 3-D.
        """
        if self.dim != 2:
            raise MeshError("boundary_loops exists only for 2-D meshes")
        return loops_of_cells(self.local_points, self.face_pairs, self.face_cells, self.n_cells)

    def check_labels(self, labels: ArrayLike) -> Int:
        """Return part labels as ``(n_cells,)`` int64, or raise MeshError unless they cover 0..k−1."""
        return check_labels(labels, self.n_cells)

    @cached_property
    def fingerprint(self) -> str:
        """Hash of points and faces, by which a hierarchy identifies its mesh."""
        digest = hashlib.sha256()  # in hardware on most machines
        for array in (self.points, self.face_offsets, self.face_vertices, self.face_cells):
            digest.update(repr(array.shape).encode())
            digest.update(narrow(array).data)
        return digest.hexdigest()[:32]
