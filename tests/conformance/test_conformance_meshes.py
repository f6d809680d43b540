"""The suite's own meshes and its reference solver."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from agglo_core.arrays import frozen_int
from agglo_core.conformance.engine.reference import TwoPointFlux
from agglo_core.conformance.inputs import small_meshes
from agglo_core.conformance.inputs.cases import cases, cases_in_3d, level_case, part_of_level, tiny
from agglo_core.conformance.inputs.questions import fingerprints, global_random
from agglo_core.conformance.laws.parts import loose_parts
from agglo_core.graph.objectives import OBJECTIVES
from agglo_core.hierarchy import Hierarchy
from agglo_core.problems import Diffusion
from agglo_core.registry import KINDS


def arrays_of(value):
    """Every array in the fields of a case's arguments."""
    if isinstance(value, np.ndarray):
        yield value
    elif hasattr(value, "__dataclass_fields__"):
        yield from (a for name in value.__dataclass_fields__ for a in arrays_of(getattr(value, name)))
    elif isinstance(value, list | tuple):
        yield from (a for item in value for a in arrays_of(item))


@pytest.mark.parametrize("kind", KINDS)
def test_all_arrays_are_read_only(kind: str) -> None:
    levels = [level_case(kind)] if kind in ("bisector", "refiner", "fixer") else []
    for case in [*cases(kind), *tiny(kind), *cases_in_3d(kind), *levels]:
        assert not any(array.flags.writeable for array in arrays_of(case.given)), case.name


def test_meshes() -> None:
    meshes = {mesh.name: mesh for mesh in small_meshes.plane_meshes()}
    for mesh in meshes.values():
        assert mesh.graph.components().max() == 0
    assert [meshes[name].n_cells for name in ("two cells", "strip", "square grid", "ring")] == [2, 9, 36, 24]
    np.testing.assert_allclose(meshes["hexagons"].cell_measures, 1.5 * np.sqrt(3))
    np.testing.assert_allclose(meshes["mixed polygons with hanging nodes"].cell_measures.sum(), 48)
    assert np.bincount(small_meshes.two_grids().graph.components()).tolist() == [6, 6]
    assert small_meshes.boxes().n_cells == 30
    assert small_meshes.change_mesh(meshes["strip"], "scaled by 1e7")[0].h == pytest.approx(1e7 * np.sqrt(2))


def test_a_level_has_blocks_of_extreme_sizes() -> None:
    level = small_meshes.level()
    assert np.diff(level.offsets).tolist() == [4000] + [16] * 60
    assert np.array_equal(level.components(), level.block_ids)
    part = part_of_level(level_case("refiner"), [5, 0])
    assert part.given[0].n == len(part.given[1]) == 4016
    assert part.given[2].tolist() == level_case("refiner").given[2][[5, 0]].tolist()


def test_objectives_by_hand() -> None:
    graph = small_meshes.grid(4, 1, width=2.0).graph
    labels = frozen_int([0, 0, 1, 1])
    values = {name: measure(graph, labels) for name, measure in OBJECTIVES.items()}
    hexagons = 8 * 5 / (18 * 3**0.5) * 4, 2 * (2 * 3**0.5 * 4) ** 0.5
    assert values == pytest.approx(
        {"solver": 8 / hexagons[0] + 0.2 * 1 / hexagons[1]}
        | {"interface": 1, "cut": 1, "compactness": 8, "balance": 32, "diameter": np.sqrt(17)}
        | {"measure_balance": 32, "cell_balance": 2 * 2**2, "run_balance": 2 * 2**2}
        | {"normalised_cut": 2 / 3, "shape": 8, "roundness": 2 - 2 * 3.8 * 4 / (10 * np.sqrt(17))}
    )
    assert loose_parts(graph, frozen_int([0, 1, 0, 0])) == {(0, 0): 2, (0, 1): 1}


def test_fingerprints_tell_where_a_change_is() -> None:
    graph = small_meshes.line(3)
    before = dict(fingerprints((graph, [1])))
    graph.data["new"] = np.ones(3)  # type: ignore[index]
    after = dict(fingerprints((graph, [1])))
    assert {path for path in after if before.get(path) != after[path]} == {"[0].data", "[0].data['new']"}


def test_the_global_random_state_comes_back() -> None:
    np.random.seed(7)  # noqa: NPY002
    first = np.random.random()  # noqa: NPY002
    np.random.seed(7)  # noqa: NPY002
    with global_random(1) as unmoved:
        assert unmoved()
        np.random.random(3)  # noqa: NPY002
        assert not unmoved()
    assert np.random.random() == first  # noqa: NPY002


def test_the_reference_solver_is_exact_for_linear_solutions() -> None:
    mesh = small_meshes.grid(6, 4, width=0.5)
    hierarchy = Hierarchy(mesh, mesh.graph, [frozen_int(np.arange(24) // 6)], [{"n_parts": 4}], nested=True)
    everywhere = Diffusion(kappa=3.0, source=0.0, dirichlet={0: lambda p: 1 + p[:, 0] - 2 * p[:, 1]})
    x, y = mesh.cell_centroids.T
    np.testing.assert_allclose(TwoPointFlux().solve(everywhere, hierarchy).x, 1 + x - 2 * y)
    middle = mesh.points[mesh.face_pairs].mean(axis=1)[:, 0]
    tags = np.select([middle == 0, middle == 3], [1, 2], 0) * (mesh.face_cells[:, 1] < 0)
    tagged = replace(mesh, face_tags={"boundary": tags})
    mixed = Diffusion(kappa=2.0, source=0.0, dirichlet={1: 5.0}, neumann={2: 4.0})  # u = 5 + 2 x
    solution = TwoPointFlux().solve(mixed, replace(hierarchy, fine=tagged))
    np.testing.assert_allclose(solution.x, 5 + 2 * x)
    assert solution.residuals[-1] < 1e-8 * solution.residuals[0]
