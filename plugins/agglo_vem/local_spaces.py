"""Unknowns of virtual elements, and their projections on the cells."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from functools import cached_property
from typing import Any, Final, NamedTuple

import numpy as np
from scipy import sparse

from agglo_core.authoring import Float, Int, Mesh, OptionError, fields, frozen_float, frozen_int
from agglo_vem.frames import Frames
from agglo_vem.monomials import count, derivatives, monomials, products

_ENTRIES: Final = 4_000_000
"""Maximum number of matrix entries in a batch of cells, some tens of MB."""

LOBATTO: Final = {
    1: (frozen_float([0.0, 1.0]), frozen_float([0.5, 0.5])),
    2: (frozen_float([0.0, 0.5, 1.0]), frozen_float([1.0, 4.0, 1.0]) / 6.0),
    3: (
        frozen_float([0.0, 0.5 - 0.5 / 5**0.5, 0.5 + 0.5 / 5**0.5, 1.0]),
        frozen_float([1.0, 5.0, 5.0, 1.0]) / 12.0,
    ),
}
"""Gauss–Lobatto points and weights on [0, 1] by degree: the nodes of an edge."""


class LocalSpaces(NamedTuple):
    """Local spaces of a batch of cells with equal numbers of unknowns N.

    Polynomials are given by coefficients of the m monomials of the cell coordinates.

    Attributes
    ----------
    cells : (c,) int
    unknowns : (c, N) int
    of_polynomials : (c, N, m) float
        Local unknowns of the monomials.
    gradient : (c, d, n, N) float
        L2 projection of the gradient to polynomials of degree k − 1.
    elliptic, l2 : (c, m, N) float
        Elliptic projection, and L2 projection by the enhanced space.
    """

    cells: Int
    unknowns: Int
    of_polynomials: Float
    gradient: Float
    elliptic: Float
    l2: Float


class Trace(NamedTuple):
    """Functions at quadrature points on boundary faces.

    Attributes
    ----------
    faces : (t,) int
        Face of each edge or triangle.
    points : (t, q, d) float
        Points relative to the mesh origin.
    weights : (t * q,) float
    values : (t * q, n) sparse
    """

    faces: Int
    points: Float
    weights: Float
    values: sparse.csr_array


@dataclass(frozen=True, eq=False)
class Space:
    """Virtual element space of degree k on a mesh.

    Unknowns are the values at vertices, at the k − 1 inner Gauss–Lobatto points of each edge, and in each
    cell the means of the function times the monomials up to degree k − 2. In 3-D the functions are linear on
    the triangles between the edges of a face and the mean of its vertices, where they have the mean value.
    """

    mesh: Mesh
    degree: int

    def __post_init__(self) -> None:
        if self.mesh.dim == 3 and self.degree != 1:
            raise OptionError(f"virtual elements in 3-D have degree 1, given degree = {self.degree}")

    @cached_property
    def frames(self) -> Frames:
        """Cell coordinates."""
        return Frames(self.mesh)

    @cached_property
    def vertices(self) -> Int:
        """Points with an unknown: those of faces."""
        return frozen_int(np.unique(self.mesh.face_vertices))

    @cached_property
    def numbers(self) -> Int:
        """Unknown of each point ``(n_points,)``, −1 without one."""
        numbers = np.full(self.mesh.n_points, -1)
        numbers[self.vertices] = np.arange(len(self.vertices))
        return frozen_int(numbers)

    @property
    def per_cell(self) -> int:
        """Number of unknowns inside each cell."""
        return count(self.degree - 2, self.mesh.dim) if self.degree > 1 else 0

    @property
    def n_outer(self) -> int:
        """Number of unknowns at vertices and on edges, the first of all."""
        return len(self.vertices) + (self.degree - 1) * self.mesh.n_faces

    @property
    def n(self) -> int:
        """Number of unknowns."""
        return self.n_outer + self.per_cell * self.mesh.n_cells

    @cached_property
    def edge_nodes(self) -> Int:
        """Unknowns ``(n_faces, k + 1)`` along each edge of a 2-D mesh, ends included."""
        ends, inner = self.numbers[self.mesh.face_pairs], self.degree - 1
        on_edges = len(self.vertices) + np.arange(self.mesh.n_faces * inner).reshape(self.mesh.n_faces, inner)
        return np.concatenate((ends[:, :1], on_edges, ends[:, 1:]), axis=1)

    @cached_property
    def node_points(self) -> Float:
        """Points ``(n_outer, d)`` of the vertices and edge nodes, relative to the mesh origin."""
        points = self.mesh.local_points[self.vertices]
        if self.degree == 1:
            return points
        ends, along = self.mesh.local_points[self.mesh.face_pairs], LOBATTO[self.degree][0][1:-1, None]
        on_edges = (1.0 - along) * ends[:, :1] + along * ends[:, 1:]
        return np.concatenate((points, on_edges.reshape(-1, 2)))

    def inner(self, cells: Int) -> Int:
        """Return the unknowns inside cells ``(c, per_cell)``."""
        return self.n_outer + cells[:, None] * self.per_cell + np.arange(self.per_cell)

    def batches(self) -> Iterator[LocalSpaces]:
        """Yield the local spaces of all cells, in batches of cells with equal numbers of corners."""
        of_cells = self._of_polyhedra if self.mesh.dim == 3 else self._of_polygons
        offsets = self.mesh.cell_vertices[0] if self.mesh.dim == 3 else self.frames.corners.offsets
        sizes = np.diff(offsets)
        for size in np.unique(sizes):
            cells = np.flatnonzero(sizes == size)
            step = max(1, _ENTRIES // int(size * self.degree + self.per_cell) ** 2)
            for first in range(0, len(cells), step):
                yield of_cells(cells[first : first + step], int(size))

    # -- polygons ----------------------------------------------------------------------------------
    @cached_property
    def _sides(self) -> Int:
        """Unknowns ``(c, k + 1)`` along the edge that starts at each corner, in the direction of the loop."""
        corners, n = self.frames.corners, self.mesh.n_points
        starts, ends = corners.vertices, corners.vertices[corners.following]
        pairs = self.mesh.face_pairs
        keys = np.concatenate((pairs[:, 0] * n + pairs[:, 1], pairs[:, 1] * n + pairs[:, 0]))
        order = np.argsort(keys, kind="stable")
        # Of faces with equal ends, the one with the cell of the corner on its left is required.
        owners = np.concatenate(self.mesh.face_cells.T)
        order = order[owners[order] >= 0]
        found = order[np.searchsorted(keys[order], starts * n + ends)]
        nodes = self.edge_nodes[found % self.mesh.n_faces]
        return np.where((found < self.mesh.n_faces)[:, None], nodes, nodes[:, ::-1])

    def _of_polygons(self, cells: Int, size: int) -> LocalSpaces:
        k, corners, frames = self.degree, self.frames.corners, self.frames
        chosen = corners.offsets[cells][:, None] + np.arange(size)
        after = corners.following[chosen] - corners.offsets[cells][:, None]
        before = np.argsort(after, axis=1)
        # Nodes along the edges in cell coordinates, and ∮ v q·n by Gauss–Lobatto weights.
        flat = np.repeat(cells, size)
        points = self.mesh.local_points[corners.vertices[chosen]].reshape(-1, 2)
        start = frames.coordinates(flat, points).reshape(len(cells), size, 2)
        edges = np.take_along_axis(start, after[..., None], axis=1) - start
        at, weights = LOBATTO[k]
        nodes = start[:, :, None] + at[:, None] * edges[:, :, None]
        normals = np.stack((edges[..., 1], -edges[..., 0]), axis=-1)
        sizes = self.mesh.cell_measures[cells] * np.linalg.det(frames.maps[cells])
        tests = weights[:, None] * monomials(nodes, k - 1)  # (c, size, k + 1, n)
        boundary = tests[..., None] * (normals / sizes[:, None, None])[:, :, None, None]
        last = np.take_along_axis(boundary[:, :, k], before[..., None, None], axis=1)
        moved = np.moveaxis(
            boundary[:, :, 1:k].reshape(len(cells), size * (k - 1), *boundary.shape[3:]), 1, -1
        )
        ends = np.moveaxis(boundary[:, :, 0] + last, 1, -1)
        # −mean(v div q): the moments are unknowns.
        inside = np.zeros((*ends.shape[:-1], self.per_cell))
        if k > 1:
            inside -= np.moveaxis(derivatives(k - 1, 2), 0, 1)
        rights = np.moveaxis(np.concatenate((ends, moved, inside), axis=-1), 2, 1)  # (c, d, n, N)
        side = self._sides[chosen]
        unknowns = np.concatenate(
            (side[:, :, 0], side[:, :, 1:k].reshape(len(cells), size * (k - 1)), self.inner(cells)), axis=1
        )
        on_boundary = np.concatenate((start, nodes[:, :, 1:k].reshape(len(cells), size * (k - 1), 2)), axis=1)
        return self._projected(cells, unknowns, on_boundary, rights, size)

    # -- polyhedra ---------------------------------------------------------------------------------
    @cached_property
    def _fans(self) -> tuple[Int, sparse.csr_array, Float]:
        """Triangles between the edges of each face and the mean of its vertices.

        Returns their faces ``(t,)``, the values at their corners ``(3 t, n_points)``, by those at the points,
        and the corners ``(t, 3, 3)``, relative to the mesh origin.
        """
        mesh, sizes = self.mesh, np.diff(self.mesh.face_offsets)
        faces, t = np.repeat(np.arange(mesh.n_faces), sizes), len(mesh.face_vertices)
        onward = np.arange(1, t + 1)
        onward[mesh.face_offsets[1:] - 1] = mesh.face_offsets[:-1]
        means = sparse.csr_array(
            (1.0 / sizes[faces], mesh.face_vertices, mesh.face_offsets), shape=(mesh.n_faces, mesh.n_points)
        )
        starts = sparse.csr_array(
            (np.ones(t), mesh.face_vertices, np.arange(t + 1)), shape=(t, mesh.n_points)
        )
        order = np.arange(3 * t).reshape(3, t).T.ravel()
        corners = sparse.csr_array(sparse.vstack((starts, starts[onward], means[faces])))[order]
        return faces, corners, (corners @ mesh.local_points).reshape(t, 3, 3)

    @cached_property
    def _fluxes(self) -> Float:
        """Vectors ∮ φ n ``(v, 3)`` of each vertex of each cell by its volume, as ``mesh.cell_vertices``."""
        mesh = self.mesh
        faces, corners, (a, b, c) = self._fans[0], self._fans[1], self._fans[2].transpose(1, 0, 2)
        vectors, means = (
            np.cross(a - c, b - c) / 2.0,
            sparse.kron(sparse.eye_array(len(faces)), [[1 / 3] * 3]),
        )
        offsets, vertices = mesh.cell_vertices
        cells = np.repeat(np.arange(mesh.n_cells), np.diff(offsets))
        # Sums over the triangles around each cell, outward
        side, triangle = np.nonzero(mesh.face_cells[faces].T >= 0)
        around = sparse.csr_array(
            (1.0 - 2.0 * side, (mesh.face_cells[faces[triangle], side], triangle)),
            shape=(mesh.n_cells, len(faces)),
        )
        of_points = sparse.csr_array(means @ corners)
        found = np.stack(
            [
                sparse.csr_array(around @ (sparse.diags_array(axis) @ of_points))[cells, vertices]
                for axis in vectors.T
            ],
            axis=1,
        )
        # Linear functions have their exact gradients, also on faces that are not plane.
        volumes = np.bincount(cells, (found * mesh.local_points[vertices]).sum(axis=1), mesh.n_cells) / 3.0
        return found / volumes[cells, None]

    def _of_polyhedra(self, cells: Int, size: int) -> LocalSpaces:
        offsets, vertices = self.mesh.cell_vertices
        chosen = offsets[cells][:, None] + np.arange(size)
        points = self.mesh.local_points[vertices[chosen]].reshape(-1, 3)
        start = self.frames.coordinates(np.repeat(cells, size), points).reshape(len(cells), size, 3)
        inverse = np.linalg.inv(self.frames.maps[cells])
        slopes = np.einsum("cba,cvb->cav", inverse, self._fluxes[chosen])  # gradients by cell coordinates
        return self._projected(cells, self.numbers[vertices[chosen]], start, slopes[:, :, None], size)

    # -- both --------------------------------------------------------------------------------------
    def _projected(self, cells: Int, unknowns: Int, nodes: Float, rights: Float, size: int) -> LocalSpaces:
        """Compute the projections of a batch of cells.

        Parameters
        ----------
        cells : (c,) int
        unknowns : (c, N) int
        nodes : (c, v, d) float
            Cell coordinates of the unknowns on the boundary.
        rights : (c, d, n, N) float
            Means of the derivatives times the monomials of degree k − 1.
        size : int
            Number of corners.
        """
        k, dim, inner = self.degree, self.mesh.dim, self.per_cell
        gram = self.means[cells][:, products(k, dim)]
        slopes, low = derivatives(k, dim), rights.shape[2]
        # Gradient: mean(Π∇v · q) = mean(∇v · q) for all q of degree k − 1.
        gradient: Any = np.linalg.solve(gram[:, None, :low, :low], rights)
        # Elliptic projection: equal means of ∇v·∇m, and an equal mean over the corners or the cell.
        stiffness = np.einsum("aij,cjk,alk->cil", slopes, gram[:, :low, :low], slopes, optimize=True)
        right = np.einsum("aij,cajn->cin", slopes, rights, optimize=True)
        at_nodes = monomials(nodes, k)
        if inner:
            stiffness[:, 0], right[:, 0, nodes.shape[1]] = gram[:, 0], 1.0
        else:
            stiffness[:, 0], right[:, 0, :size] = at_nodes[:, :size].mean(axis=1), 1.0 / size
        elliptic = np.linalg.solve(stiffness, right)
        # L2 projection: the moments up to degree k − 2 are unknowns, the others are those of Π∇v.
        moments = gram @ elliptic
        moments[:, :inner] = 0.0
        moments[:, np.arange(inner), nodes.shape[1] + np.arange(inner)] = 1.0
        l2: Any = np.linalg.solve(gram, moments) if k > 1 else elliptic
        of_polynomials = np.concatenate((at_nodes, gram[:, :inner]), axis=1)
        return LocalSpaces(cells, unknowns, of_polynomials, gradient, elliptic, l2)

    @cached_property
    def means(self) -> Float:
        """Means ``(n_cells, m)`` of the monomials to degree 2 k."""
        return self.frames.means(2 * self.degree)

    def trace(self, faces: Int) -> Trace:
        """Return all functions at quadrature points on some faces, exact up to degree 2 k + 3."""
        mesh, k = self.mesh, self.degree
        if mesh.dim == 2:
            nodes, weights = fields.gauss(k + 2)
            along = 0.5 * (1.0 + nodes)[:, None]
            at = LOBATTO[k][0]
            others = [np.delete(at, j) for j in range(k + 1)]
            shapes = np.stack(
                [((along - o) / (at[j] - o)).prod(axis=1) for j, o in enumerate(others)], axis=1
            )
            ends = mesh.local_points[mesh.face_pairs[faces]]
            points = (1.0 - along) * ends[:, :1] + along * ends[:, 1:]
            sizes = mesh.face_measures[faces][:, None] * 0.5 * weights
            corners, of_corners = np.arange(len(faces) * (k + 1)), self.edge_nodes[faces].ravel()
            nodal = sparse.csr_array(
                (np.ones(len(corners)), (corners, of_corners)), shape=(len(corners), self.n)
            )
            pieces = faces
        else:
            of_faces, values, triangles = self._fans
            chosen = np.isin(of_faces, faces)
            pieces, triangles = frozen_int(of_faces[chosen]), triangles[chosen]
            reference, weights = fields.simplex_rule(2, 3)
            shapes = np.concatenate((1.0 - reference.sum(axis=1, keepdims=True), reference), axis=1)
            points = shapes @ triangles
            normals = np.cross(triangles[:, 0] - triangles[:, 2], triangles[:, 1] - triangles[:, 2])
            sizes = np.linalg.norm(normals, axis=1)[:, None] * weights
            nodal = sparse.csr_array(values[np.repeat(chosen, 3)][:, self.vertices])
        blocks = sparse.kron(sparse.eye_array(len(pieces)), shapes, format="csr")
        return Trace(pieces, points, sizes.ravel(), sparse.csr_array(blocks @ nodal))
