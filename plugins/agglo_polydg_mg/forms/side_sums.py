"""Contributions of the sides of polyhedra to the matrix and to the penalty."""

from __future__ import annotations

import numpy as np

from agglo_core.authoring import Float, Int, Mask, frozen_float, frozen_int
from agglo_core.fields.gauss_points import simplex_rule
from agglo_core.threads import COSTLY, over_ranges
from agglo_polydg_mg.forms.face_quadrature import OnFaces
from agglo_polydg_mg.space.basis import Basis
from agglo_polydg_mg.space.polynomials import monomials, orders


def add_sides(basis: Basis, sides: Int, mine: Mask, sigma: Float, on_faces: OnFaces, blocks: Float) -> None:
    """Add the bilinear forms of ``sides (k,)`` to the matrix ``blocks`` in the rows of ``mine`` cells.

    ``sigma (n_faces,)`` is the penalty, ``on_faces`` the coefficient on all faces, from
    :func:`~agglo_polydg_mg.forms.face_quadrature.on_both_sides`.
    """
    from agglo_polydg_mg.forms.side_kernels import side_blocks

    mesh, p, all_sides = basis.mesh, basis.degree, basis.sides
    rule = _rule(p + 1, on_faces.kappa)
    of_faces = mesh.face_offsets, mesh.face_vertices, mesh.face_cells, mesh.face_normals
    of_sides = all_sides.offsets, all_sides.faces, all_sides.cells, frozen_int(sides), mine, basis.pattern[3]
    frames = basis.boxes, basis.scale, frozen_float(sigma), *on_faces
    side_blocks(mesh.local_points, *of_faces, *of_sides, *frames, *rule, *monomials(p), blocks)


def solid_requirements(basis: Basis, on_faces: OnFaces, blocks: Float, held: Mask) -> tuple[Float, Mask]:
    """Return the penalties ``(n_faces, 2)`` that polyhedra require on penalised faces, ``held``.

    The second result is a mask of cells that are not too thin for the eigenvalue problem. As in 2-D, with
    sides instead of faces: all faces of a side have its penalty.
    """
    from agglo_polydg_mg.forms.side_trace_kernels import solid_penalties

    # 1. Requirements for the sides
    mesh, p, sides = basis.mesh, basis.degree, basis.sides
    requirements = np.zeros((len(sides.cells), 2))
    form_data = held, *on_faces, *_rule(p, on_faces.kappa), orders(p, 3)
    of_cells = basis.boxes, basis.scale, basis.fill, frozen_float(blocks)
    shape = mesh.local_points, mesh.face_offsets, mesh.face_vertices, mesh.face_cells, mesh.face_normals

    def require(start: int, stop: int) -> np.ndarray:
        of_sides = sides.offsets, sides.faces, sides.cells
        cells = sides.cell_offsets[start : stop + 1], sides.cell_sides, start
        data = *(a[start:stop] for a in of_cells), *form_data
        return np.asarray(solid_penalties(*shape, *of_sides, *cells, *data, requirements))

    resolved = np.concatenate(over_ranges(require, mesh.n_cells, few=COSTLY))
    # 2. Spread to the faces, in owner–neighbour order
    turned = mesh.face_cells[:, 0] != sides.cells[sides.of_faces, 0]
    of_faces = np.where(held[:, None], requirements[sides.of_faces], 0.0)
    of_faces[turned] = of_faces[turned][:, ::-1]
    return of_faces, resolved


def _rule(n: int, kappa: Float) -> tuple[Float, Float]:
    """Return a quadrature rule on triangles, at the points where κ is sampled, or with n per direction."""
    count = kappa.shape[2]
    return simplex_rule(2, n if count == 1 else round(np.sqrt(count)))
