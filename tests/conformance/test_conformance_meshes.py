"""The suite's own meshes and its reference solver."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from two_point_flux import TwoPointFlux

from agglo_core.arrays import frozen_int
from agglo_core.conformance.inputs import small_meshes
from agglo_core.conformance.inputs.cases import (
    ON_GRAPHS,
    SIBLINGS,
    cases,
    large_case,
    large_cases,
    part_of_level,
    siblings,
)
from agglo_core.conformance.inputs.drawn import PLANE, SOLID, DrawnMesh
from agglo_core.conformance.inputs.mesh_changes import halve_faces
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
    drawn = [*large_cases(kind)[:3], large_case(kind)] if kind in ON_GRAPHS else []
    fixed = [case for place in ("plane", "space", "one cell") for case in cases(kind, place)]
    for case in [*drawn, *fixed, *siblings(kind)] if kind in SIBLINGS else fixed:
        assert not any(array.flags.writeable for array in arrays_of(case.given)), case.name


def test_meshes() -> None:
    np.testing.assert_allclose(small_meshes.hexagons(5, 4).cell_measures, 1.5 * np.sqrt(3))
    np.testing.assert_allclose(small_meshes.mixed_polygons().cell_measures.sum(), 48)
    assert np.bincount(DrawnMesh(cells=6, copies=2).mesh.graph.components()).tolist() == [6, 6]
    assert small_meshes.boxes().n_cells == 30
    for family in (*PLANE, *SOLID):
        mesh = DrawnMesh(family, cells=30, jitter=0.25).mesh
        assert mesh.graph.components().max() == 0
        assert abs(mesh.n_cells - 30) <= (60 if family == "hub" else 18)


def test_faces_are_halved() -> None:
    for family in ("voronoi", "tetrahedra"):
        mesh = DrawnMesh(family, cells=20).mesh
        halves = halve_faces(mesh)
        assert halves.n_faces == mesh.n_faces * mesh.dim
        np.testing.assert_allclose(halves.cell_measures, mesh.cell_measures)


def test_blocks_can_be_taken_out() -> None:
    level = large_cases("refiner")[2]
    assert level.given[0].n_blocks == 40
    assert np.array_equal(level.given[0].components(), level.given[0].block_ids)
    part = part_of_level(level, [5, 0])
    assert part.given[0].n == len(part.given[1]) == level.given[0].sizes[[5, 0]].sum()
    assert part.given[2].tolist() == level.given[2][[5, 0]].tolist()


def test_large_graphs_exceed_the_usual_integers() -> None:
    chain, _, _, many = (case.given for case in large_cases("fixer"))
    assert np.bincount(chain[1]).tolist() == [1500, 1500]
    assert many[0].n_blocks == 6000
    assert many[0].n_blocks * int(many[1].max() + 1) > 2**16


def test_objectives_by_hand() -> None:
    squares = small_meshes.grid(4, 1)
    graph = replace(squares, points=squares.points * (2.0, 1.0)).graph
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


def test_fingerprints_locate_a_change() -> None:
    graph = DrawnMesh(cells=3).mesh.graph
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
    squares = small_meshes.grid(6, 4)
    mesh = replace(squares, points=squares.points * (0.5, 1.0))
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
