"""Linear systems that are not like those of diffusion, for laws of solvers: each has one solution."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
from scipy import sparse

from agglo_core.arrays import frozen_float, frozen_int
from agglo_core.conformance import small_meshes
from agglo_core.conformance.case import Case
from agglo_core.conformance.solver_cases import on_levels, uneven
from agglo_core.problems import Linear

__all__ = ["unlike_diffusion"]


def unlike_diffusion() -> list[Case]:
    """Systems that are not symmetric, not definite, or have other couplings, unknowns or storage."""
    mesh = small_meshes.grid(6, 6)
    row, column = np.divmod(np.arange(36), 6)
    hierarchy = on_levels(mesh, frozen_int(row // 2 * 3 + column // 2))
    plain = uneven(mesh.graph, 1, seed=2)
    below = sparse.tril(plain.A, -1)
    far = sparse.csr_array((np.full(6, 8.0), (np.arange(0, 36, 7), np.zeros(6, int))), shape=(36, 1))
    shift = float(np.median(plain.A.diagonal())) / 2
    systems = {
        "a matrix that is not symmetric": replace(plain, A=sparse.csr_array(plain.A - 0.7 * below)),
        "a matrix with zeros above the diagonal": replace(plain, A=sparse.csr_array(sparse.tril(plain.A))),
        "a symmetric matrix that is not definite": replace(
            plain, A=sparse.csr_array(plain.A - shift * sparse.eye_array(36))
        ),
        "positive couplings of cells that are not neighbours": replace(
            plain, A=sparse.csr_array(plain.A + far @ far.T)
        ),
        "cells with one, two and three unknowns": _of_unequal_cells(plain),
        "a matrix with entries stored twice, in any order": replace(plain, A=_stored_twice(plain.A)),
    }
    return [Case(name, (system, hierarchy)) for name, system in systems.items()]


def _of_unequal_cells(scalar: Linear) -> Linear:
    """One, two or three unknowns in a cell, of different weights in the couplings."""
    widths = 1 + np.arange(scalar.A.shape[0]) % 3
    cells = np.repeat(np.arange(len(widths)), widths)
    n = len(cells)
    weights = np.random.default_rng(4).uniform(0.3, 1.0, n)
    spread = sparse.csr_array((weights, (np.arange(n), cells)), shape=(n, len(widths)))
    A = sparse.csr_array(spread @ scalar.A @ spread.T + 20.0 * sparse.eye_array(n))
    b = frozen_float(np.random.default_rng(5).standard_normal(n))
    return Linear(A, b, frozen_int(np.concatenate([[0], np.cumsum(widths)])))


def _stored_twice(A: sparse.csr_array) -> sparse.csr_array:
    """The same matrix, each entry as the sum of two that are not beside each other."""
    n = A.shape[0]
    parts = [np.split(each, A.indptr[1:-1]) for each in (A.indices, A.data)]
    indices = np.concatenate([np.concatenate([one, one[::-1]]) for one in parts[0]])
    data = np.concatenate([np.concatenate([0.25 * one, 0.75 * one[::-1]]) for one in parts[1]])
    return sparse.csr_array((data, indices, 2 * A.indptr), shape=(n, n))
