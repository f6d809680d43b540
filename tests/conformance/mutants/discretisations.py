"""Correct discretisations, and discretisations that break one law first."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
from conformance.mutants.mutant import Mutant
from scipy import sparse
from scipy.spatial import cKDTree

from agglo_core import OptionError
from agglo_core.problems import System
from agglo_polydg_mg.polydg import PolyDG


class WithoutSamples(PolyDG):
    sample = None


class BlocksOfUnknowns(PolyDG):
    def assemble(self, problem, mesh):
        system = super().assemble(problem, mesh)
        return System.trusted(system.A, system.b, np.arange(system.n + 1), mesh)


class HalvesProjections(PolyDG):
    def project(self, mesh, function):
        return 0.5 * super().project(mesh, function)


class SamplesCorners(PolyDG):
    def sample(self, mesh, x):
        samples = super().sample(mesh, x)
        return replace(samples, values=samples.values[:3])


class FirstTriangles(PolyDG):
    def sample(self, mesh, x):
        samples = super().sample(mesh, x)
        return replace(samples, simplices=samples.simplices[:1])


class NearestCell(PolyDG):
    """Take the value of the cell with the nearest centroid."""

    def evaluate(self, mesh, x, points):
        values = super().evaluate(mesh, x, points)
        nearest = cKDTree(mesh.cell_centroids).query(points)[1]
        at_centroids = super().evaluate(mesh, x, mesh.cell_centroids)
        return np.where(np.isnan(values), np.nan, at_centroids[nearest])


class WeakPenalty(PolyDG):
    def __init__(self):
        super().__init__(penalty=0.2)


class ForgetsJumps(PolyDG):
    """Average the coefficient over the mesh."""

    def assemble(self, problem, mesh):
        kappa = problem.kappa(mesh.cell_centroids) if callable(problem.kappa) else problem.kappa
        return super().assemble(replace(problem, kappa=float(np.mean(kappa))), mesh)


class InTheBox(PolyDG):
    """Project onto functions that are constant in each cell."""

    def project(self, mesh, function):
        x = super().project(mesh, function).copy()
        x.reshape(mesh.n_cells, -1)[:, 1:] = 0.0
        return x


class ForgetsTheSource(PolyDG):
    """Halve the source away from the boundary."""

    def assemble(self, problem, mesh):
        system = super().assemble(problem, mesh)
        b = np.array(system.b).reshape(mesh.n_cells, -1)
        touching = np.unique(mesh.face_cells[mesh.outer_faces, 0])
        inside = np.setdiff1d(np.arange(mesh.n_cells), touching)
        b[inside] *= 0.5
        return replace(system, b=b.ravel())


class CoarseOfCells(PolyDG):
    """Take the mean of κ over the mesh for each agglomerate."""

    def coarse_operator(self, problem, mesh, labels):
        return super().coarse_operator(replace(problem, kappa=float(np.mean(problem.kappa))), mesh, labels)


class ErrorsPerCell(PolyDG):
    def errors(self, problem, mesh, x):
        return {name: value / mesh.n_cells for name, value in super().errors(problem, mesh, x).items()}


class WholeLoad(PolyDG):
    def load(self, problem, mesh, b):
        return b


class TurnsGradients(PolyDG):
    def gradient(self, mesh, x, points=None):
        return super().gradient(mesh, x, points)[:, ::-1]


class GradientsOutside(PolyDG):
    def gradient(self, mesh, x, points=None):
        return np.nan_to_num(super().gradient(mesh, x, points))


class DoublesIntegrals(PolyDG):
    def integrals(self, mesh, x):
        return 2.0 * super().integrals(mesh, x)


class WeighsUnknowns(PolyDG):
    def mass(self, mesh):
        return sparse.eye_array(self.basis(mesh).n, format="csr")


class SkewMass(PolyDG):
    def mass(self, mesh):
        M = sparse.lil_array(super().mass(mesh))
        M[0, 1] += 1.0
        return M


class HalvesWeights(PolyDG):
    def quadrature(self, mesh):
        rule = super().quadrature(mesh)
        return rule._replace(weights=0.5 * rule.weights)


class ShufflesPoints(PolyDG):
    def quadrature(self, mesh):
        rule = super().quadrature(mesh)
        return rule._replace(points=rule.points[::-1])


class PointwiseFluxes(PolyDG):
    """Fluxes of one-sided gradients, which are consistent, but not conservative."""

    def fluxes(self, problem, mesh, x):
        samples = self.sample(mesh, x)
        cells = samples.cells[samples.simplices[:, 0]]
        sizes = np.bincount(cells, minlength=mesh.n_cells)
        slopes = np.stack([np.bincount(cells, g, mesh.n_cells) / sizes for g in samples.gradients.T], axis=1)
        return -mesh.face_measures * (slopes[mesh.face_cells[:, 0]] * mesh.face_normals).sum(axis=1)


class RefusesAll(PolyDG):
    def assemble(self, problem, mesh):
        raise OptionError("there is no such problem")


class WeighsResidualsByCoefficient(PolyDG):
    def residuals(self, problem, mesh, x):
        squares = super().residuals(problem, mesh, x)
        return {name: values / float(problem.kappa) ** 2 for name, values in squares.items()}


class RootsOfResiduals(PolyDG):
    def residuals(self, problem, mesh, x):
        squares = super().residuals(problem, mesh, x)
        return {name: -np.sqrt(values) for name, values in squares.items()}


class IgnoresBoundaryGaps(PolyDG):
    """Take the values at the boundary for gaps to the data."""

    def residuals(self, problem, mesh, x):
        squares = super().residuals(problem, mesh, x)
        return squares | {
            "jump": squares["jump"] + super().evaluate(mesh, x, mesh.cell_centroids) ** 2 * 1e-9
        }


CORRECT = [(PolyDG, {"deterministic": True, "3d": True, "pickles": True, "patch_test": True})]

MUTANTS = [
    Mutant("answers", RefusesAll, "refuses every problem"),
    Mutant("has_all_methods", WithoutSamples, "no method sample"),
    Mutant("system_fits_mesh", BlocksOfUnknowns, "block_offsets holds the unknowns of cell c"),
    Mutant("constants_kept", HalvesProjections, "evaluate of the projection of 3"),
    Mutant("constants_kept", SamplesCorners, "sample of the projection of 3"),
    Mutant("samples_fill_cells", FirstTriangles, "the measure of simplices"),
    Mutant("samples_fill_cells", NearestCell, "nearest centroid"),
    Mutant("symmetric_and_definite", WeakPenalty, "enlarge the penalty"),
    Mutant("linear_found", ForgetsJumps, "the solution is"),
    Mutant("patch_test", InTheBox, "the projection of a linear function", promises={"patch_test": True}),
    Mutant("finer_is_closer", ForgetsTheSource, "integrated over cells"),
    Mutant("coarse_like_fine", CoarseOfCells, "one agglomerate per cell"),
    Mutant("errors_measured", ErrorsPerCell, "the root of the measure"),
    Mutant("load_and_residuals", WholeLoad, "the load with boundary value 3"),
    Mutant("gradient_fits_values", TurnsGradients, "gradient predicts"),
    Mutant("gradient_fits_values", GradientsOutside, "outside the mesh"),
    Mutant("integrals_fit_values", DoublesIntegrals, "the integral over a cell"),
    Mutant("mass_integrates", WeighsUnknowns, "the measure of cell 0"),
    Mutant("mass_integrates", SkewMass, "not symmetric"),
    Mutant("quadrature_fits_values", HalvesWeights, "the sum of the weights"),
    Mutant("quadrature_fits_values", ShufflesPoints, "that of evaluate"),
    Mutant("fluxes_balance_source", PointwiseFluxes, "but its source is"),
    Mutant("near_the_error", WeighsResidualsByCoefficient, "with kappa 1000"),
    Mutant("near_the_error", RootsOfResiduals, "are not 36 squares"),
    Mutant("zero_for_exact", IgnoresBoundaryGaps, "the estimate of the exact solution"),
]
