"""Matrices and right-hand sides of virtual elements."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property
from typing import Any, Final, NamedTuple

import numpy as np
from scipy import sparse

from agglo_core.authoring import Diffusion, Field, Float, Int, Mask, OptionError, fields
from agglo_vem.local_spaces import Space, Trace
from agglo_vem.monomials import count, products

STABILISATIONS = ("dofi", "d-recipe")

_ROUNDING: Final = 1e-6
"""Relative difference of exact solution and Dirichlet data that counts as rounding."""


class _Entries:
    """Sum of local matrices, as triples of row, column and value."""

    def __init__(self, n: int) -> None:
        self._n, self._parts = n, list[tuple[Int, Int, Float]]()

    def add(self, unknowns: Int, blocks: Float) -> None:
        """Add symmetric blocks ``(c, N, N)`` of cells with ``unknowns (c, N)``."""
        rows = np.broadcast_to(unknowns[:, :, None], blocks.shape).ravel()
        columns = np.broadcast_to(unknowns[:, None], blocks.shape).ravel()
        self._parts.append((rows, columns, (0.5 * (blocks + blocks.transpose(0, 2, 1))).ravel()))

    def matrix(self) -> sparse.csr_array:
        """Return the sum ``(n, n)``."""
        rows, columns, values = (np.concatenate(parts) for parts in zip(*self._parts, strict=True))
        return sparse.csr_array(sparse.coo_array((values, (rows, columns)), shape=(self._n, self._n)))


def stiffness(space: Space, kappa: Any, stabilisation: str) -> _Entries:
    """Return ∫ Π∇u·κΠ∇v and the stabilisation.

    With the local unknowns χ_i and the elliptic projection Π, the stabilisation is the sum of
    s_i χ_i(u − Πu) χ_i(v − Πv). ``dofi``: s_i is the mean of κ (trace by dimension), in 3-D times |E|^⅓.
    ``d-recipe``: the larger of this and the diagonal of the first term.
    """
    mesh, k, entries = space.mesh, space.degree, _Entries(space.n)
    means = space.frames.tensor_means(kappa, 2 * k - 2)
    scale = (
        np.trace(means[..., 0], axis1=1, axis2=2) / mesh.dim * mesh.cell_measures ** (1.0 - 2.0 / mesh.dim)
    )
    for batch in space.batches():
        maps = space.frames.maps[batch.cells]
        mapped = np.einsum("cax,cxym,cby->cabm", maps, means[batch.cells], maps, optimize=True)
        weights = (
            mapped[..., products(k - 1, mesh.dim)]
            * mesh.cell_measures[batch.cells][:, None, None, None, None]
        )
        slopes = batch.gradient
        images = np.einsum("cabij,cbjn->cain", weights, slopes, optimize=True)
        c, d, low, n = slopes.shape
        blocks = slopes.reshape(c, d * low, n).transpose(0, 2, 1) @ images.reshape(c, d * low, n)
        rest = np.eye(n) - batch.of_polynomials @ batch.elliptic
        sizes = np.repeat(scale[batch.cells][:, None], n, axis=1)
        if stabilisation == "d-recipe":
            sizes = np.maximum(sizes, np.einsum("cnn->cn", blocks))
        entries.add(batch.unknowns, blocks + rest.transpose(0, 2, 1) @ (sizes[:, :, None] * rest))
    return entries


def add_mass(entries: _Entries, space: Space, field: Field, name: str) -> None:
    """Add ∫ c Πu Πv with the L2 projection Π, and |E| c Σ χ_i(u − Πu) χ_i(v − Πv)."""
    k, dim = space.degree, space.mesh.dim
    means = space.frames.weighted_means(field, 2 * k, name) * space.mesh.cell_measures[:, None]
    for batch in space.batches():
        weights = means[batch.cells][:, products(k, dim)]
        rest = np.eye(batch.l2.shape[2]) - batch.of_polynomials @ batch.l2
        blocks = batch.l2.transpose(0, 2, 1) @ weights @ batch.l2
        entries.add(batch.unknowns, blocks + weights[:, :1, :1] * (rest.transpose(0, 2, 1) @ rest))


def mass(space: Space) -> sparse.csr_array:
    """Return the mass matrix ``(n, n)``."""
    entries = _Entries(space.n)
    add_mass(entries, space, 1.0, "mass")
    return entries.matrix()


def load(space: Space, source: Field) -> Float:
    """Return ∫ f Πv ``(n,)`` with the L2 projection Π."""
    means = space.frames.weighted_means(source, space.degree, "source") * space.mesh.cell_measures[:, None]
    result = np.zeros(space.n)
    for batch in space.batches():
        values = np.einsum("cm,cmn->cn", means[batch.cells], batch.l2)
        result += np.bincount(batch.unknowns.ravel(), values.ravel(), space.n)
    return result


def polynomials(space: Space, x: Float) -> Float:
    """Return the coefficients ``(n_cells, m)`` of the L2 projections of a function on the cells."""
    x = np.asarray(x, dtype=float)
    if x.shape != (space.n,):
        raise OptionError(f"x must have the shape ({space.n},), given {x.shape}")
    result = np.empty((space.mesh.n_cells, count(space.degree, space.mesh.dim)))
    for batch in space.batches():
        result[batch.cells] = np.einsum("cmn,cn->cm", batch.l2, x[batch.unknowns])
    return result


class Fixed(NamedTuple):
    """Unknowns ``(f,)`` on Dirichlet faces, and the data there."""

    unknowns: Int
    values: Float


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
    def fixed(self) -> Fixed:
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
        return Fixed(unknowns, sums[unknowns] / counts[unknowns])

    def require_consistent(self) -> None:
        """Raise OptionError if the exact solution differs from the Dirichlet data at a node.

        Data with one value per cell may be averages, and are not compared.
        """
        exact, mesh, (unknowns, values) = self.problem.exact, self.space.mesh, self.fixed
        averages = any(np.ndim(data) for data in self.problem.dirichlet.values() if not callable(data))
        if exact is None or averages or not len(unknowns):
            return
        points = self.space.node_points[unknowns] + mesh.origin
        gaps = np.abs(fields.sample(exact, points, "exact") - values)
        inside = np.abs(fields.sample(exact, mesh.cell_centroids, "exact")).max()
        worst = int(np.argmax(gaps))
        if gaps[worst] > _ROUNDING * max(inside, np.abs(values).max()):
            raise OptionError(
                f"exact contradicts the Dirichlet data: at {points[worst].tolist()} they differ by "
                f"{gaps[worst]:g}; pass the exact values as Dirichlet data, or no exact solution"
            )

    @cached_property
    def trace(self) -> Trace:
        """Functions at quadrature points on Neumann and Robin faces."""
        return self.space.trace(self.parts.natural)

    def _data(self, data: Any, name: str) -> Float:
        faces, points = self.trace.faces, self.trace.points
        return fields.boundary_values(self.space.mesh, self.parts.tags, data, faces, points, name).ravel()

    @cached_property
    def alpha(self) -> Float:
        """Coefficient α of Robin data at the points of the trace.

        Raises
        ------
        OptionError
            If it is negative.
        """
        alpha = self._data({tag: pair[0] for tag, pair in self.problem.robin.items()}, "alpha of robin")
        if alpha.size and alpha.min() < 0.0:
            raise OptionError(f"alpha of robin must not be negative: it is {alpha.min():g}")
        return alpha

    def matrix(self) -> Any:
        """Return ∫ α u v ``(n, n)``."""
        values = self.trace.values
        return values.T @ (sparse.diags_array(self.trace.weights * self.alpha) @ values)

    def load(self) -> Float:
        """Return ∫ g v ``(n,)`` of Neumann and Robin data."""
        robin = {tag: pair[1] for tag, pair in self.problem.robin.items()}
        data = self._data(self.problem.neumann, "neumann") + self._data(robin, "robin")
        return np.asarray(self.trace.values.T @ (self.trace.weights * data))

    def held(self) -> Mask:
        """Return True for cells whose component has Dirichlet data, a positive α or a positive reaction."""
        mesh = self.space.mesh
        reaction = fields.nonnegative(mesh, self.problem.reaction)
        cells = self.space.frames.weighted_means(reaction, 0, "reaction")[:, 0] > 0.0
        firm = (self.alpha > 0.0).reshape(self.trace.points.shape[:2]).any(axis=1)
        held = np.concatenate((self.parts.dirichlet, self.trace.faces[firm]))
        cells[mesh.face_cells[held, 0]] = True
        component = mesh.graph.components()
        return np.isin(component, component[cells])


def system(terms: BoundaryTerms, stabilisation: str) -> tuple[sparse.csr_array, Float]:
    """Return matrix and right-hand side of a problem.

    Dirichlet unknowns have rows with the diagonal entry alone, so that the matrix remains symmetric.
    """
    space, problem = terms.space, terms.problem
    entries = stiffness(space, fields.positive(space.mesh, problem.kappa), stabilisation)
    if not fields.is_zero(problem.reaction):
        add_mass(entries, space, fields.nonnegative(space.mesh, problem.reaction), "reaction")
    A = entries.matrix()
    if problem.robin:
        A = sparse.csr_array(A + terms.matrix())
    g = np.zeros(space.n)
    g[terms.fixed.unknowns] = terms.fixed.values
    free = np.ones(space.n)
    free[terms.fixed.unknowns] = 0.0
    diagonal = A.diagonal()
    b = free * (natural_load(terms) - A @ g) + diagonal * g
    keep = sparse.diags_array(free)
    A = sparse.csr_array(keep @ A @ keep + sparse.diags_array(diagonal * (1.0 - free)))
    A.eliminate_zeros()
    return A, b


def natural_load(terms: BoundaryTerms) -> Float:
    """Return ∫ f v and the load of Neumann and Robin data ``(n,)``."""
    return load(terms.space, terms.problem.source) + terms.load()


def mean_kappa(space: Space, kappa: Any) -> Float:
    """Return the mean of κ in each cell ``(n_cells,)``, of a tensor its trace by the dimension."""
    mesh = space.mesh
    means = space.frames.tensor_means(fields.positive(mesh, kappa), 0)[..., 0]
    return np.asarray(np.trace(means, axis1=1, axis2=2) / mesh.dim)


def per_unknown(space: Space, of_cells: Float) -> Float:
    """Return the largest value of the cells at each unknown ``(n,)``."""
    result = np.zeros(space.n)
    for batch in space.batches():
        np.maximum.at(result, batch.unknowns, of_cells[batch.cells][:, None])
    return result
