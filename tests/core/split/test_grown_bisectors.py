"""Bisectors of the core and the learned one, in one call: as good as depth by depth, with all guarantees."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest
from growth_checks import assert_kept, grown, length, lumpy_graph
from hypothesis import given, settings, strategies as st
from toy_constraints import Line

import agglo_core as agglo
from agglo_core import Mesh, samples
from agglo_core.compiled import kernel
from agglo_core.graph.blocks import block_shares, principal_frames, split_at_median
from agglo_core.registry import default
from agglo_core.split.ordered_frames import frames_of_blocks
from agglo_core.split.piece_shares import new_order, split_in_order
from agglo_core.threads import using_threads

SEEDS = st.integers(0, 10**6)
NAMES = ("inertial", "sweep", "gnn")


class DepthByDepth:
    """A bisector that the driver asks for one depth after the other."""

    def __init__(self, name: str) -> None:
        self.tool = default().build("bisector", name)

    def bisect_level(self, level, seeds):
        return self.tool.bisect_level(level, seeds)


@pytest.mark.parametrize(("name", "dim"), [(name, dim) for name in NAMES for dim in (2, 3)])
@settings(max_examples=20, deadline=None)
@given(n=st.integers(3, 90), seed=SEEDS, refined=st.booleans(), data=st.data())
def test_counts_are_exact_on_any_graph(
    name: str, dim: int, n: int, seed: int, refined: bool, data: st.DataObject
) -> None:
    graph = lumpy_graph(n, dim, seed)
    least = int(graph.components().max()) + 1
    parts = data.draw(st.lists(st.integers(least, n), min_size=1, max_size=3))
    hierarchy = grown(graph, bisector=name, refiners=("interface",) if refined else (), n_parts=parts)
    assert hierarchy.parts == sorted(parts, reverse=True)
    assert_kept(hierarchy)


@pytest.mark.parametrize("name", NAMES)
@settings(max_examples=10, deadline=None)
@given(n=st.integers(20, 400), seed=SEEDS, factors=st.lists(st.floats(0.5, 6.0), min_size=1, max_size=3))
def test_no_part_is_wider_than_h_star(name: str, n: int, seed: int, factors: list[float]) -> None:
    mesh = samples.voronoi(n, seed=seed)
    hierarchy = grown(mesh, bisector=name, h_factor=sorted(set(factors)))
    assert_kept(hierarchy)
    for labels, target in zip(hierarchy.levels, hierarchy.targets, strict=True):
        wide = mesh.graph.part_diameters(labels) > target["h_star"] * (1 + 1e-9)
        assert (np.bincount(labels)[wide] == 1).all()


MESHES = {
    "triangles": lambda seed: samples.random_triangles(3000, seed=seed),
    "voronoi": lambda seed: samples.voronoi(4000, seed=seed),
    "tetrahedra": lambda seed: samples.tetrahedra(10),
}


@pytest.mark.parametrize("kind", MESHES)
@pytest.mark.parametrize("name", NAMES)
def test_shapes_are_as_good_as_depth_by_depth(name: str, kind: str) -> None:
    mesh = MESHES[kind](11)
    targets: list[dict[str, Any]] = [{"cells_per_part": 16}, {"h_factor": 4.0}]
    for target in targets:
        options = {**target, "polish": False}
        one = grown(mesh, bisector=name, **options)
        other = agglo.agglomerate(mesh, bisector=DepthByDepth(name), **options)
        cuts = [length(mesh.graph, each.levels[0]) for each in (one, other)]
        assert cuts[0] <= 1.04 * cuts[1]
        assert one.parts[0] <= 1.03 * other.parts[0]


@pytest.mark.parametrize("name", NAMES)
def test_space(name: str) -> None:
    for mesh in (samples.boxes(6), samples.tetrahedra(4)):
        hierarchy = grown(mesh, bisector=name, n_parts=(27, 5))
        assert hierarchy.parts == [27, 5]
        assert_kept(hierarchy)
        assert_kept(grown(mesh, bisector=name, h_factor=(2.0, 4.0)))


def turned(mesh: Mesh, angle: float, shift: float) -> Mesh:
    cos, sin = np.cos(angle), np.sin(angle)
    loops = mesh.boundary_loops
    points = mesh.points @ np.array([[cos, sin], [-sin, cos]]) + shift
    return Mesh.from_polygons(points, (loops.loop_offsets, loops.vertices))


@pytest.mark.parametrize("name", ["sweep", "gnn"])
@pytest.mark.parametrize(("angle", "shift"), [(0.0, 0.0), (0.3, 0.0), (1.1, 1e6)])
def test_squares_of_the_paper_become_squares(name: str, angle: float, shift: float) -> None:
    for mesh in (samples.paper("squares"), samples.paper("triangles"), samples.squares(24)):
        hierarchy = grown(turned(mesh, angle, shift), bisector=name, h_star=np.sqrt(2) / 4)
        assert hierarchy.parts == [16]
        area = np.bincount(hierarchy.levels[0], mesh.graph.measures)
        np.testing.assert_allclose(area, 1 / 16, rtol=1e-9)


@pytest.mark.parametrize("name", NAMES)
def test_constraints_are_kept_and_threads_change_nothing(name: str) -> None:
    mesh = samples.random_triangles(20_000, seed=3)
    options = {"bisector": name, "cells_per_part": (20, 200), "constraints": [Line()]}
    one, two = (grown_with(count, mesh, options) for count in (1, 3))
    for labels, others in zip(one.levels, two.levels, strict=True):
        assert np.array_equal(labels, others)
        right = np.bincount(labels, mesh.graph.centroids[:, 0] > 0.5)
        assert np.isin(right / np.bincount(labels), (0.0, 1.0)).all()


def grown_with(threads: int, mesh: Mesh, options: dict[str, Any]) -> agglo.Hierarchy:
    with using_threads(threads):
        return grown(mesh, **options)


def test_a_bisector_that_looks_ahead_runs_depth_by_depth() -> None:
    mesh = samples.voronoi(60, seed=1)
    hierarchy = agglo.agglomerate(mesh, bisector=("gnn", {"lookahead": 3}), h_factor=4.0)
    assert "grow" not in hierarchy.statistics["seconds"]


# --- the kernels, against obvious references --------------------------------------------------------------


@kernel
def upper_half(along, weight):
    """Which points lie above the weighted median."""
    n, d = len(weight), len(along)
    all_three = np.zeros((3, n))
    for c in range(d):
        for k in range(n):
            all_three[c, k] = along[c, k]
    order = new_order(n)
    split_in_order(n, d, all_three, 0, weight, 0.5, order)
    return order.upper


def block_of_points(n: int, dim: int, seed: int, lattice: bool) -> agglo.Graph:
    rng = np.random.default_rng(seed)
    points = rng.standard_normal((n, dim)) * (3.0, 2.0, 1.0)[:dim]
    points = np.rint(2 * points) if lattice else points  # whole numbers: many are equally high
    weights = rng.integers(0, 3, n) + 0.25 * rng.integers(0, 2)
    return agglo.Graph.from_arrays(np.zeros(n + 1, int), [], points, measures=weights, weights=weights)


@settings(max_examples=30, deadline=None)
@given(st.integers(2, 400), st.sampled_from([2, 3]), SEEDS, st.booleans())
def test_a_piece_is_halved_to_the_very_cells_of_a_block(n: int, dim: int, seed: int, lattice: bool) -> None:
    block = block_of_points(n, dim, seed, lattice)
    points, weights = block.centroids, block_shares(block.weights, block.block_ids)
    upper = upper_half(np.ascontiguousarray(points.T), weights)
    assert np.array_equal(upper, split_at_median(block, points[:, 0], points[:, 1:]))


@settings(max_examples=25, deadline=None)
@given(st.integers(2, 200), st.sampled_from([2, 3]), SEEDS)
def test_frames_are_those_that_numpy_finds(n: int, dim: int, seed: int) -> None:
    block = block_of_points(n, dim, seed, lattice=False)
    given_frames, given_coordinates = frames_of_blocks(block.offsets, block.centroids, block.weights)
    frames, coordinates = principal_frames(block)
    seconds = block_shares(block.weights, block.block_ids) @ coordinates**2
    clear = np.append(seconds[1:] < 0.89 * seconds[:-1] - 1e-9, True)  # axes of cubes have no order
    alone = clear & np.append(True, clear[:-1])
    turned = np.abs(np.sum(given_frames[0] * frames[0], axis=1))
    np.testing.assert_allclose(turned[alone], 1.0, rtol=1e-6)
    np.testing.assert_allclose(np.abs(given_coordinates[:, alone]), np.abs(coordinates[:, alone]), atol=1e-6)


STRUCTURED = {
    "paper_squares": lambda: samples.paper("squares"),
    "paper_triangles": lambda: samples.paper("triangles"),
    "squares": lambda: samples.squares(24),
    "hexagons": lambda: samples.hexagons(14),
    "boxes": lambda: samples.boxes(8),
    "tetrahedra": lambda: samples.tetrahedra(5),
    "random": lambda: samples.random_triangles(2000, seed=4),
}


@pytest.mark.parametrize("kind", STRUCTURED)
@pytest.mark.parametrize("refiners", [("interface",), ()])
def test_inertial_makes_the_very_parts_of_depth_by_depth(kind: str, refiners: tuple[str, ...]) -> None:
    mesh = STRUCTURED[kind]()
    for target in ({"h_factor": (2.0, 3.0, 5.0)}, {"n_parts": (64, 16)}):
        options = {**target, "polish": False, "refiners": refiners}
        one = grown(mesh, bisector="inertial", **options)
        other = agglo.agglomerate(mesh, bisector=DepthByDepth("inertial"), **options)
        for labels, others in zip(one.levels, other.levels, strict=True):
            assert np.array_equal(labels, others)


@pytest.mark.parametrize("kind", ["squares", "hexagons", "boxes", "tetrahedra", "random"])
@pytest.mark.parametrize("refiners", [("interface",), ()])
def test_cuts_are_moved_to_the_very_cells_of_depth_by_depth(kind: str, refiners: tuple[str, ...]) -> None:
    mesh = STRUCTURED[kind]()
    options: dict[str, Any] = {"n_parts": (60, 12, 3), "polish": False, "refiners": refiners}
    one = grown(mesh, bisector="inertial", **options)
    other = agglo.agglomerate(mesh, bisector=DepthByDepth("inertial"), **options)
    for labels, others in zip(one.levels, other.levels, strict=True):
        assert np.array_equal(labels, others)
