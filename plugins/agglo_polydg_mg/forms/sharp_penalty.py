"""Smallest jump penalty that keeps the bilinear form provably coercive, cell by cell.

The local trace inverse inequality is evaluated exactly, without a constant from the literature, as the
largest eigenvalue of a small matrix for each cell (K. Shahbazi, J. Comput. Phys. 205, 2005, and Y.
Epshteyn, B. Rivière, J. Comput. Appl. Math. 206, 2007, give explicit constants for simplices). The
derivation is in ``docs/mathematics.md``.
"""

from __future__ import annotations

import numpy as np

from agglo_core.authoring import Field, Float, Int, Mesh, MeshError, frozen_float
from agglo_core.fields.gauss_points import gauss
from agglo_core.fields.rules import inside
from agglo_core.fields.tensors import Tensor
from agglo_core.fields.values import sample
from agglo_core.threads import COSTLY, over_ranges
from agglo_polydg_mg.forms.face_quadrature import OnFaces
from agglo_polydg_mg.forms.penalty import simplex_heights
from agglo_polydg_mg.forms.side_sums import solid_requirements
from agglo_polydg_mg.space.basis import Basis

MARGIN = 0.25
"""Smallest eigenvalue of the matrix A relative to the square of the DG norm. A larger value gives larger
penalties, by the factor 1 / (1 − MARGIN)² (benchmarks/penalty.py)."""


def sharp_penalty(
    basis: Basis,
    kappa: Field | Tensor,
    on_faces: OnFaces,
    blocks: Float,
    natural: Int | None = None,
) -> Float:
    """Return the penalty σ ``(n_faces,)``, in 1 / length, with a(v, v) >= MARGIN · ‖v‖²_DG for all v.

    ‖v‖²_DG = Σ_K ‖√κ ∇v‖² + Σ_F γσ ‖[v]‖². Each cell computes its requirement for each of its faces, and
    σ_F is the sum of the two. If a cell is so thin that its stiffness matrix is singular to rounding, its
    requirement follows from the triangles that fit on its faces, times their number: safe, but larger than
    necessary. In 3-D all faces between two cells share one penalty, and so do a cell's boundary faces with
    the same main direction.

    Parameters
    ----------
    basis : Basis
    kappa : number, ``(n_cells,)``, callable or Tensor
        The coefficient.
    on_faces : OnFaces
        The coefficient on both face sides, at the Gauss points of the face pieces for a callable.
    blocks : (n_cells, n_local, n_local) float
        ∫ κ∇φ_i·∇φ_j per cell.
    natural : (k,) int, optional
        Neumann faces: they have no penalty, and no requirement.

    Raises
    ------
    MeshError
        For cells that overlap themselves, or are flat; in 3-D, for cells that are too thin and not convex.
    """
    # 1. Requirements by eigenvalues
    penalised = np.ones(basis.mesh.n_faces, bool)
    if natural is not None:
        penalised[natural] = False
    by_eigenvalues = _plane_requirements if basis.mesh.dim == 2 else solid_requirements
    requirements, resolved = by_eigenvalues(basis, on_faces, blocks, penalised)
    # 2. Requirements of thin cells by simplices
    if not resolved.all():
        requirements += _by_simplices(basis, kappa, on_faces, penalised, ~resolved)
    # 3. Sum of both sides
    return frozen_float(requirements.sum(axis=1) / (1.0 - MARGIN) ** 2)


def _plane_requirements(
    basis: Basis, on_faces: OnFaces, blocks: Float, penalised: np.ndarray
) -> tuple[Float, np.ndarray]:
    """Return the penalties ``(n_faces, 2)`` that cells require on their faces, by eigenvalues in 2-D.

    The second result is a mask of resolved cells ``(n_cells,)``. Cells too thin for the eigenvalue problem
    are not resolved.
    """
    from agglo_polydg_mg.forms.trace_kernels import side_penalties

    mesh = basis.mesh
    count = on_faces.kappa.shape[2]
    rule = basis.degree if count == 1 else count
    points, (offsets, faces), sides = mesh.local_points, mesh.cell_faces, (mesh.face_pairs, mesh.face_cells)
    of_cells, requirements = (basis.boxes, basis.scale, basis.fill, blocks), np.zeros((mesh.n_faces, 2))

    def require(start: int, stop: int) -> np.ndarray:
        cell_data = [a[start:stop] for a in of_cells]
        shape = points, offsets[start : stop + 1], faces, *sides, start
        return np.asarray(
            side_penalties(*shape, penalised, *cell_data, *on_faces, *gauss(rule), basis.degree, requirements)
        )

    return requirements, np.concatenate(over_ranges(require, mesh.n_cells, few=COSTLY))


def _by_simplices(
    basis: Basis, kappa: Field | Tensor, on_faces: OnFaces, penalised: np.ndarray, thin: np.ndarray
) -> Float:
    """Return the penalties ``(n_faces, 2)`` that ``thin`` cells ``(n_cells,)`` require on their faces.

    They come from simplices inside the cells. On a triangle T with height h over the face F, ‖q‖²_F <= p
    (p + 1) / h ‖q‖²_T for polynomials q with degree p − 1 (T. Warburton, J. Hesthaven, Comput. Methods
    Appl. Mech. Engrg. 192, 2003), on a tetrahedron p (p + 2) / h. The triangles of a cell overlap, at worst
    all of them.
    """
    # 1. Sides of thin cells with penalised faces
    mesh, p = basis.mesh, basis.degree
    heights = simplex_heights(mesh, thin)
    inner = mesh.face_cells[:, 1] >= 0
    sides = np.stack((mesh.face_cells[:, 0], np.where(inner, mesh.face_cells[:, 1], 0)), axis=1)
    counts = np.where(penalised[:, None] & thin[sides] & np.isfinite(heights), 1.0, 0.0)
    counts[~inner, 1] = 0.0
    if (heights[counts > 0] == 0).any():
        cells = np.unique(sides[(counts > 0) & (heights == 0)])[:5].tolist()
        raise MeshError(
            f"cells {cells} overlap themselves, or are flat: no simplex fits into them on some face"
        )
    # 2. Largest ωκ on each face, number of faces and least κ of each cell
    kappa_in, kappa_out = on_faces.kappa[:, 0], on_faces.kappa[:, 1]
    half = 0.5 * kappa_in * (kappa_out / (kappa_in + kappa_out))  # ωκ/2, equal from both sides
    rows = np.where(_of_rows(mesh, inner, kappa_in)[:, None], half, kappa_in)
    most = np.stack(
        [largest_per_face((rows * _share(kappa, on_faces, k)).max(axis=1), mesh) for k in (0, 1)], axis=1
    )
    n_faces = np.bincount(sides.ravel(), counts.ravel(), mesh.n_cells)
    least = _least_kappa(mesh, kappa, p)
    return np.asarray(counts * p * (p + mesh.dim - 1) * most * n_faces[sides] / (heights * least[sides]))


def _share(kappa: Field | Tensor, on_faces: OnFaces, side: int) -> Float | float:
    """Return the factor by which the flux of a tensor exceeds a multiple of the energy density.

    With d = κn / (n·κn), (d·∇v)² <= ∇v·κ∇v / (n·κn), and (d·∇v)² <= |d|² |∇v|² if κ varies in the cell.
    """
    if not isinstance(kappa, Tensor):
        return 1.0
    if kappa.by_cell:
        return 1.0 / on_faces.kappa[:, side]
    return np.asarray((on_faces.directions[:, side] ** 2).sum(axis=2))


def _of_rows(mesh: Mesh, values: np.ndarray, rows: Float) -> np.ndarray:
    """Expand face values to the rows of coefficients, which refer to faces or to triangles of faces."""
    if len(values) == len(rows):
        return values
    return np.repeat(values, np.diff(mesh.face_offsets) - mesh.dim + 1)


def largest_per_face(rows: Float, mesh: Mesh) -> Float:
    """Return the largest value on each face ``(n_faces,)``, from values per face or per triangle."""
    if len(rows) == mesh.n_faces:
        return rows
    starts = mesh.face_offsets[:-1] - (mesh.dim - 1) * np.arange(mesh.n_faces)
    return np.asarray(np.maximum.reduceat(rows, starts))


def _least_kappa(mesh: Mesh, kappa: Field | Tensor, degree: int) -> Float:
    """Return the least κ per cell ``(n_cells,)``, for a callable over the quadrature points.

    For a callable tensor it is the least eigenvalue, and 1 for one that is constant in each cell.
    """
    if isinstance(kappa, Tensor) and kappa.by_cell:
        return np.ones(mesh.n_cells)
    if isinstance(kappa, Tensor):
        given = kappa
        return _least_kappa(mesh, lambda x: frozen_float(np.linalg.eigvalsh(given.at(x, None))[:, 0]), degree)
    if not callable(kappa):
        return np.broadcast_to(np.asarray(kappa, float), (mesh.n_cells,))
    least = np.full(mesh.n_cells, np.inf)
    for batch in inside(mesh, 2 * degree + 3):
        np.minimum.at(least, batch.cells, sample(kappa, batch.points + mesh.origin, "kappa"))
    return least
