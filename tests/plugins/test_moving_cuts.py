"""Solutions on cuts of one hierarchy: projection from cut to cut, and evolution on a cut that moves."""

from __future__ import annotations

import numpy as np
import pytest

import agglo_core as agglo
from agglo_core import Diffusion, Hierarchy, OptionError, samples
from agglo_core.hierarchy.cuts import Cut


def random_cut(hierarchy: Hierarchy, rng: np.random.Generator) -> Cut:
    cut = hierarchy.cut_at(len(hierarchy.levels) - 1)
    for _ in range(3):
        cut = cut.refine(rng.random(cut.n_parts) < 0.4).cut
    return cut


@pytest.mark.parametrize(("dim", "degree"), [(2, 1), (2, 3), (3, 1)])
def test_a_transfer_is_the_l2_projection_and_preserves_the_integral(dim: int, degree: int) -> None:
    mesh = samples.random_triangles(200, seed=3) if dim == 2 else samples.random_tetrahedra(40, seed=3)
    hierarchy, rng = agglo.agglomerate(mesh, cells_per_part=(4, 16, 64)), np.random.default_rng(degree)
    old, new, cells = (*(random_cut(hierarchy, rng) for _ in range(2)), hierarchy.cut_at(-1))
    problem = Diffusion(source=lambda x: np.exp(3.0 * x[:, 0]))
    solution = agglo.solve(hierarchy.above(old), problem, degree=degree)
    moved, fine = solution.transfer(old, new), solution.transfer(old, cells)
    assert moved.integral() == pytest.approx(solution.integral(), rel=1e-12)
    assert (moved.mesh, moved.problem) == (new.mesh, None)
    # In single cells the function is itself
    points = fine.discretisation.quadrature(mesh).points
    np.testing.assert_allclose(fine.evaluate(points), solution.evaluate(points), atol=1e-9)
    # The gap of the projection is orthogonal to all functions on the new cut
    gap = fine.x - moved.transfer(new, cells).x
    tested = moved.transfer(new, new).x * rng.normal(size=moved.x.shape)
    mass = fine.discretisation.mass(mesh)
    onto_cells = fine.discretisation.transfer(new.mesh, tested, mesh, new.overlaps(cells))
    assert np.sqrt(gap @ mass @ gap) > 1e-6
    assert abs(gap @ mass @ onto_cells) < 1e-12 * np.sqrt((fine.x @ mass @ fine.x) * (tested @ tested))


def test_overlaps_are_the_pairs_with_a_common_cell() -> None:
    hierarchy = agglo.agglomerate(samples.voronoi(200, seed=1), cells_per_part=(4, 16))
    one, other = (random_cut(hierarchy, np.random.default_rng(seed)) for seed in (1, 2))
    pairs = sorted(set(zip(one.labels.tolist(), other.labels.tolist(), strict=True)))
    assert one.overlaps(other).tolist() == [list(pair) for pair in pairs]


def test_an_evolution_continues_on_another_cut() -> None:
    mesh, heat = samples.voronoi(300, seed=5), Diffusion(source=0.0, neumann={0: 0.0})
    hierarchy = agglo.agglomerate(mesh, cells_per_part=(3, 9, 27))
    state, cut = (lambda x: np.exp(-20.0 * (x**2).sum(axis=1))), hierarchy.cut_at(0)
    integrals, rng = [], np.random.default_rng(2)
    for _ in range(3):
        *_, (_, solution) = agglo.evolve(hierarchy.above(cut), heat, state, 0.02, 0.01, "be", tolerance=1e-11)
        new = random_cut(hierarchy, rng)
        state, cut = solution.transfer(cut, new), new
        integrals += [solution.integral(), state.integral()]
    np.testing.assert_allclose(integrals, integrals[0], rtol=1e-8)


def test_solutions_on_other_meshes_are_refused() -> None:
    hierarchy = agglo.agglomerate(samples.squares(8), n_parts=(16, 4))
    old, new = hierarchy.cut_at(1), hierarchy.cut_at(0)
    solution = agglo.solve(hierarchy.above(old), degree=2)
    with pytest.raises(OptionError, match=r"the solution is on Mesh.*not on the mesh of the first cut"):
        solution.transfer(new, old)
    with pytest.raises(OptionError, match="different hierarchies"):
        solution.transfer(old, agglo.agglomerate(samples.squares(8), n_parts=9).cut_at(0))
    for u0, degree in ((solution, 2), (solution.transfer(old, new), 1)):
        with pytest.raises(OptionError, match=r"u0 has .* unknowns on Mesh.*expected .* Solution.transfer"):
            agglo.evolve(hierarchy.above(new), Diffusion(), u0, 1.0, 0.5, degree=degree)
    vertices = agglo.solve(hierarchy.above(old), discretisation="vem")
    with pytest.raises(OptionError, match="has no method transfer"):
        vertices.transfer(old, new)
