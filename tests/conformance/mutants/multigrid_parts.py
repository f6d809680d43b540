"""Correct transfers, coarse operators and coarse solvers, and components that break one law first."""

from __future__ import annotations

import numpy as np
from conformance.mutants.mutant import Mutant
from scipy import sparse
from scipy.sparse.linalg import cg, splu

from agglo_core.errors import OptionError
from agglo_core.problems import CoarseSpace


def constants(step):
    """Return the piecewise constant prolongation, with a coarse unknown per unknown of a cell."""
    width, *others = np.unique(np.diff(step.block_offsets))
    if others:
        raise OptionError("parts with unequal numbers of unknowns are not supported")
    ones = np.ones(len(step.parents))
    inject = sparse.csr_array((ones, (np.arange(len(ones)), step.parents)))
    return sparse.csr_array(sparse.kron(inject, sparse.eye_array(width)))


class Constants:
    def prolongation(self, step):
        return constants(step)


class Described:
    """Constants for parts with unequal numbers of unknowns, with coarse near-null vectors."""

    def prolongation(self, step):
        sizes = self.sizes(step)
        part = np.repeat(np.arange(len(sizes)), sizes)
        place = np.arange(len(part)) - np.repeat(np.cumsum(sizes) - sizes, sizes)
        keys, columns = np.unique([step.parents[part], place], axis=1, return_inverse=True)
        P = sparse.csr_array((np.ones(len(part)), (np.arange(len(part)), columns.ravel())))
        offsets = np.searchsorted(keys[0], np.arange(step.parents.max() + 2))
        return CoarseSpace(P, offsets, self.coarse(P, step.near_null))

    def sizes(self, step):
        return np.diff(step.block_offsets)

    def coarse(self, P, near_null):
        return (P.T @ near_null) / P.sum(axis=0)[:, None]  # means


class MeanSizes(Described):
    """Unknowns numbered as if all parts had the largest mean number, rounded up."""

    def sizes(self, step):
        n, parts = step.A.shape[0], len(step.parents)
        return np.diff(np.minimum(-(-n // parts) * np.arange(parts + 1), n))

    def coarse(self, P, near_null):
        return None


class SumsOnly(Described):
    """Coarse near-null vectors without the values of rotations."""

    def coarse(self, P, near_null):
        coarse = super().coarse(P, near_null)
        return np.column_stack((coarse[:, :1], np.zeros_like(coarse[:, 1:])))


class WholeNumbers(Constants):
    """Correct: numbers of eight bits and a list of offsets, which a run accepts."""

    def prolongation(self, step):
        P = super().prolongation(step)
        width = int(step.block_offsets[1])
        return CoarseSpace(P.astype(np.int8).tocoo(), list(range(0, P.shape[1] + 1, width)))


class DenseProlongation(Constants):
    def prolongation(self, step):
        return super().prolongation(step).toarray()


class OneColumnMore(Constants):
    def prolongation(self, step):
        P = super().prolongation(step)
        return sparse.csr_array(sparse.hstack([P, P[:, :1] ** 2 + sparse.eye_array(P.shape[0], 1)]))


class TwiceTheSame(Constants):
    def prolongation(self, step):
        P = super().prolongation(step)
        return sparse.csr_array(sparse.kron(P, [[1.0, 1.0]]))


class ByComponent(Constants):
    """Columns component by component."""

    def prolongation(self, step):
        P, width = super().prolongation(step), int(step.block_offsets[1])
        columns = np.arange(P.shape[1]).reshape(-1, width).T.ravel()
        return sparse.csr_array(P[:, columns])


class Differences(Constants):
    """Functions with signs that alternate from cell to cell."""

    def prolongation(self, step):
        P = super().prolongation(step)
        return sparse.csr_array(sparse.diags_array((-1.0) ** np.arange(P.shape[0])) @ P)


class RestrictsDifferently:
    def coarse_matrix(self, step, P):
        A = sparse.csr_array(P.T @ sparse.csr_array(step.A) @ P)
        return sparse.csr_array(sparse.tril(A) + 0.5 * sparse.triu(A, 1))


class Products:
    def coarse_matrix(self, step, P):
        P = sparse.csr_array(P)
        return sparse.csr_array(P.T @ sparse.csr_array(step.A) @ P)


class KeepsTheTranspose:
    """Restrict by the transpose of the first prolongation of equal shape."""

    def __init__(self):
        self.transposes = {}

    def coarse_matrix(self, step, P):
        PT = self.transposes.setdefault(P.shape, sparse.csr_array(P.T))
        return PT @ sparse.csr_array(step.A) @ sparse.csr_array(P)


class OnlyTheDiagonal(Products):
    def coarse_matrix(self, step, P):
        return sparse.csr_array(sparse.diags_array(super().coarse_matrix(step, P).diagonal()))


class DenseProducts(Products):
    def coarse_matrix(self, step, P):
        return super().coarse_matrix(step, P).toarray()


class LU:
    def solver_for(self, A):
        return splu(sparse.csc_array(A)).solve


class ReturnsLists(LU):
    """Correct: lists, which a run accepts."""

    def solver_for(self, A):
        solve = super().solver_for(A)
        return lambda b: solve(b).tolist()


class KeyedByTheTrace(LU):
    """Reuse a factorisation for matrices of equal size and trace."""

    def __init__(self):
        self.factors = {}

    def solver_for(self, A):
        key = A.shape[0], round(float(A.diagonal().sum()), 6)
        if key not in self.factors:
            self.factors[key] = super().solver_for(A)
        return self.factors[key]


class OneBuffer(LU):
    """Write all solutions for a matrix into one array."""

    def solver_for(self, A):
        solve, x = super().solver_for(A), np.empty(A.shape[0])

        def into_x(b):
            x[:] = solve(b)
            return x

        return into_x


class Regularised(LU):
    """Shift the diagonal of matrices of more than 150 rows."""

    def solver_for(self, A):
        shift = 1e-3 * A.diagonal().mean() if A.shape[0] > 150 else 0.0
        return super().solver_for(A + shift * sparse.eye_array(A.shape[0]))


class JustJacobi:
    def solver_for(self, A):
        return lambda b: b / A.diagonal()


class UntilItWillDo:
    """Conjugate gradients that stop at a tolerance."""

    def solver_for(self, A):
        return lambda b: cg(A, b, rtol=1e-3)[0]


_ALL = {"deterministic": True, "pickles": True}
CORRECT = [
    (Constants, _ALL),
    (Described, _ALL),
    (WholeNumbers, _ALL),
    (Products, _ALL),
    (LU, {**_ALL, "symmetric": True}),
    (ReturnsLists, {**_ALL, "symmetric": True}),
    (UntilItWillDo, _ALL),
]

MUTANTS = [
    Mutant("prolongation_fits", DenseProlongation, "expected a sparse matrix"),
    Mutant("prolongation_fits", OneColumnMore, "cannot be divided evenly"),
    Mutant("prolongation_fits", TwiceTheSame, "have rank"),
    Mutant("prolongation_fits", ByComponent, "part by part"),
    Mutant("near_null_kept", MeanSizes, "outside the range"),
    Mutant("near_null_kept", SumsOnly, "the coarse ones"),
    Mutant("near_null_kept", Differences, "outside the range"),
    Mutant("coarse_matrix_fits", DenseProducts, "expected a sparse matrix"),
    Mutant("coarse_matrix_fits", RestrictsDifferently, "its transpose"),
    Mutant("coarse_energy_kept", OnlyTheDiagonal, "keep the couplings"),
    Mutant("coarse_error_reduced", Regularised, "solve exactly"),
    Mutant("nothing_carried_over", KeyedByTheTrace, "key a cache"),
    Mutant("nothing_carried_over", KeepsTheTranspose, "key a cache"),
    Mutant("nothing_carried_over", OneBuffer, "return a new one"),
    Mutant("coarse_error_reduced", JustJacobi, "or iterate more"),
    Mutant("coarse_solver_symmetric", UntilItWillDo, "not linear", {"symmetric": True}),
]
