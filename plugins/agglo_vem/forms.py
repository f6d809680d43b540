"""Matrices and right-hand sides of virtual elements."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from functools import cached_property

import numpy as np
from scipy import sparse
from scipy.sparse.csgraph import connected_components

from agglo_core.authoring import Diffusion, Field, Float, Int, fields, frozen_int
from agglo_vem.local_spaces import LocalSpaces, Space, Trace
from agglo_vem.monomials import products

STABILISATIONS = ("dofi", "d-recipe")


@dataclass(frozen=True, eq=False)
class LocalForms:
    """Local matrices of a problem."""

    space: Space
    problem: Diffusion
    stabilisation: str

    @cached_property
    def _kappa(self) -> Float:
        """Means ``(n_cells, d, d, m)`` of κ times the monomials to degree 2 k − 2."""
        kappa = fields.positive(self.space.mesh, self.problem.kappa)
        return self.space.frames.tensor_means(kappa, 2 * self.space.degree - 2)

    @cached_property
    def mean_kappa(self) -> Float:
        """Mean of κ in each cell ``(n_cells,)``, of a tensor its trace by the dimension."""
        return np.asarray(np.trace(self._kappa[..., 0], axis1=1, axis2=2) / self.space.mesh.dim)

    @cached_property
    def _reaction(self) -> Float:
        """Integrals ``(n_cells, m)`` of the reaction times the monomials to degree 2 k."""
        mesh = self.space.mesh
        reaction = fields.nonnegative(mesh, self.problem.reaction)
        means = self.space.frames.weighted_means(reaction, 2 * self.space.degree, "reaction")
        return means * mesh.cell_measures[:, None]

    def stiffness(self, batch: LocalSpaces) -> tuple[Float, Float]:
        """Return ∫ Π∇u·κΠ∇v and the stabilisation, both ``(c, N, N)``.

        With the local unknowns χ_i and the elliptic projection Π, the stabilisation is the sum of
        s_i χ_i(u − Πu) χ_i(v − Πv). ``dofi``: s_i is the mean of κ (trace by dimension), in 3-D times |E|^⅓.
        ``d-recipe``: the larger of this and the diagonal of the first term.
        """
        mesh, cells, slopes = self.space.mesh, batch.cells, batch.gradient
        measures, maps = mesh.cell_measures[cells], self.space.frames.maps[cells]
        kappa = np.einsum("cax,cxym,cby->cabm", maps, self._kappa[cells], maps, optimize=True)
        weights = kappa[..., products(self.space.degree - 1, mesh.dim)] * measures[:, None, None, None, None]
        images = np.einsum("cabij,cbjn->cain", weights, slopes, optimize=True)
        c, d, low, n = slopes.shape
        first = slopes.reshape(c, d * low, n).transpose(0, 2, 1) @ images.reshape(c, d * low, n)
        scale = self.mean_kappa[cells] * measures ** (1.0 - 2.0 / d)
        sizes = np.repeat(scale[:, None], n, axis=1)
        if self.stabilisation == "d-recipe":
            sizes = np.maximum(sizes, np.einsum("cnn->cn", first))
        rest = np.eye(n) - batch.of_polynomials @ batch.elliptic
        return first, rest.transpose(0, 2, 1) @ (sizes[:, :, None] * rest)

    def mass(self, batch: LocalSpaces) -> tuple[Float, Float]:
        """Return ∫ c Πu Πv with the L2 projection Π and the reaction c, and the stabilisation.

        The stabilisation is |E| c Σ χ_i(u − Πu) χ_i(v − Πv) with the mean of c.
        """
        weights = self._reaction[batch.cells][:, products(self.space.degree, self.space.mesh.dim)]
        rest = np.eye(batch.l2.shape[2]) - batch.of_polynomials @ batch.l2
        first = batch.l2.transpose(0, 2, 1) @ weights @ batch.l2
        return first, weights[:, :1, :1] * (rest.transpose(0, 2, 1) @ rest)

    def blocks(self, batch: LocalSpaces) -> tuple[Float, Float]:
        """Return the form of the problem inside the cells, and its stabilisation."""
        forms = [self.stiffness(batch)]
        if not fields.is_zero(self.problem.reaction):
            forms.append(self.mass(batch))
        first, second = (sum(parts[1:], start=parts[0]) for parts in zip(*forms, strict=True))
        return first, second

    def matrix(self) -> sparse.csr_array:
        """Return the matrix ``(n, n)`` without boundary terms."""
        return _assembled(self.space, lambda batch: np.add(*self.blocks(batch)))


def _assembled(space: Space, blocks: Callable[[LocalSpaces], Float]) -> sparse.csr_array:
    """Return the sum ``(n, n)`` of local matrices, symmetric in spite of rounding."""

    def symmetric(batch: LocalSpaces) -> tuple[Int, Int, Float]:
        own = blocks(batch)
        return batch.unknowns, batch.unknowns, 0.5 * (own + own.transpose(0, 2, 1))

    return fields.sum_blocks((space.n, space.n), map(symmetric, space.batches()))


def mass(space: Space) -> sparse.csr_array:
    """Return the mass matrix ``(n, n)``."""
    local = LocalForms(space, Diffusion(reaction=1.0), "dofi")
    return _assembled(space, lambda batch: np.add(*local.mass(batch)))


def load(space: Space, source: Field) -> Float:
    """Return ∫ f Πv ``(n,)`` with the L2 projection Π."""
    means = space.frames.weighted_means(source, space.degree, "source") * space.mesh.cell_measures[:, None]
    result = np.zeros(space.n)
    for batch in space.batches():
        values = np.einsum("cm,cmn->cn", means[batch.cells], batch.l2)
        result += np.bincount(batch.unknowns.ravel(), values.ravel(), space.n)
    return result


@dataclass(frozen=True, eq=False)
class BoundaryTerms:
    """Terms of the boundary data of a problem."""

    space: Space
    problem: Diffusion

    @cached_property
    def parts(self) -> fields.BoundaryParts:
        """Boundary faces by kind of data."""
        return fields.boundary_parts(self.space.mesh, self.problem)

    @cached_property
    def fixed(self) -> tuple[Int, Float]:
        """Unknowns on Dirichlet faces with their values: means of the data of the faces at a node."""
        space, mesh, faces = self.space, self.space.mesh, self.parts.dirichlet
        if mesh.dim == 2:
            nodes = space.edge_nodes[faces]
        else:
            sizes = np.diff(mesh.face_offsets)
            of_face = np.repeat(np.arange(mesh.n_faces), sizes)
            chosen = np.isin(of_face, faces)
            faces, nodes = of_face[chosen], space.numbers[mesh.face_vertices[chosen]][:, None]
        points = space.node_points[nodes]
        data = fields.boundary_values(
            mesh, self.parts.tags, self.problem.dirichlet, faces, points, "dirichlet"
        )
        counts = np.bincount(nodes.ravel(), minlength=space.n_outer)
        sums = np.bincount(nodes.ravel(), data.ravel(), space.n_outer)
        unknowns = np.flatnonzero(counts)
        return unknowns, sums[unknowns] / counts[unknowns]

    def require_consistent(self) -> None:
        """Raise OptionError if the exact solution differs from the Dirichlet data at a node.

        Data with one value per cell may be averages, and are not compared.
        """
        averages = any(np.ndim(data) for data in self.problem.dirichlet.values() if not callable(data))
        if self.problem.exact is not None and not averages:
            unknowns, values = self.fixed
            fields.require_exact(
                self.space.mesh, self.problem.exact, self.space.node_points[unknowns], values
            )

    @cached_property
    def trace(self) -> Trace:
        """Functions at quadrature points on Neumann and Robin faces."""
        return self.space.trace(self.parts.natural)

    @cached_property
    def natural(self) -> Float:
        """Neumann data and g of Robin data at the points of the trace ``(t * q,)``."""
        where = self.trace.faces, self.trace.points
        return fields.natural_values(self.space.mesh, self.parts.tags, self.problem, *where).ravel()

    @cached_property
    def alpha(self) -> Float:
        """Coefficient α of Robin data at the points of the trace ``(t * q,)``."""
        where = self.trace.faces, self.trace.points
        return fields.robin_alpha(self.space.mesh, self.parts.tags, self.problem, *where).ravel()

    @cached_property
    def floating(self) -> fields.Floating | None:
        """Components where the solution is determined only up to a constant, None without any."""
        space, mesh = self.space, self.space.mesh
        if not len(self.parts.natural):
            return None
        # Cells with Dirichlet data, a positive α or a positive reaction
        reaction = fields.nonnegative(mesh, self.problem.reaction)
        cells = space.frames.weighted_means(reaction, 0, "reaction")[:, 0] > 0.0
        firm = (self.alpha > 0.0).reshape(self.trace.points.shape[:2]).any(axis=1)
        cells[mesh.face_cells[np.concatenate((self.parts.dirichlet, self.trace.faces[firm])), 0]] = True
        # Components of cells with common vertices
        offsets, vertices = mesh.cell_vertices
        beside = sparse.csr_array((np.ones(len(vertices)), vertices, offsets), (mesh.n_cells, mesh.n_points))
        component = connected_components(beside @ beside.T)[1]
        free = np.setdiff1d(component, component[cells])
        if not len(free):
            return None
        of_unknowns, ones = np.empty(space.n, int), np.ones(space.n)
        for batch in space.batches():
            of_unknowns[batch.unknowns] = component[batch.cells][:, None]
        if space.per_cell:
            ones[space.n_outer :] = space.frames.means(space.degree - 2).ravel()
        cells_of, unknowns_of = (
            [frozen_int(np.flatnonzero(of == k)) for k in free] for of in (component, of_unknowns)
        )
        return fields.Floating(mesh, cells_of, unknowns_of, ones, load(space, 1.0))

    def load(self) -> Float:
        """Return the load ``(n,)`` of source, Neumann and Robin data, balanced on floating components."""
        space, trace, source = self.space, self.trace, self.problem.source
        flux = trace.weights * self.natural
        result: Float = load(space, source) + trace.values.T @ flux
        if self.floating is None:
            return result
        size = np.repeat(space.mesh.face_cells[trace.faces, 0], trace.points.shape[1])
        sizes = np.bincount(size, np.abs(flux), space.mesh.n_cells)
        means = space.frames.weighted_means(fields.magnitude(source), 0, "source")[:, 0]
        return self.floating.balanced(result, sizes + means * space.mesh.cell_measures)


def system(terms: BoundaryTerms, stabilisation: str) -> tuple[sparse.csr_array, Float]:
    """Return matrix and right-hand side of a problem.

    Dirichlet unknowns have rows with the diagonal entry alone, so that the matrix remains symmetric.
    """
    space, mesh, problem = terms.space, terms.space.mesh, terms.problem
    local = LocalForms(space, problem, stabilisation)
    A = local.matrix()
    if problem.robin:
        values, weights = terms.trace.values, terms.trace.weights * terms.alpha
        A = sparse.csr_array(A + values.T @ (sparse.diags_array(weights) @ values))
    if terms.floating is not None:
        held = np.zeros(space.n)
        for cell, energy in terms.floating.energies(local.mean_kappa):
            held[space.numbers[mesh.cell_vertices[1][mesh.cell_vertices[0][cell]]]] = energy
        A = sparse.csr_array(A + sparse.diags_array(held))
    return fields.fix_unknowns(A, terms.load(), *terms.fixed)
