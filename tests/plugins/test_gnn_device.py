"""K-way partitions by the paper's network against slow references, piece by piece and move by move."""

from __future__ import annotations

from functools import cache

import numpy as np
import pytest
from hypothesis import given, settings, strategies as st

import agglo_core as agglo
from agglo_core import OptionError, PluginError, Target
from agglo_core.graph.objectives import OBJECTIVES

torch = pytest.importorskip("torch")
pytest.importorskip("safetensors")

from agglo_gnn.device import polish as rounds  # noqa: E402
from agglo_gnn.device.graph import DeviceGraph, components, group_sums  # noqa: E402
from agglo_gnn.device.recursion import bisect_to_parts, cut, features  # noqa: E402
from agglo_gnn.paper.bisector import PaperGNN  # noqa: E402
from agglo_gnn.paper.network import inorm  # noqa: E402

SPECS = ("voronoi:n=300,seed=4", "random_triangles:n=150,seed=2", "squares:n=16")


@cache
def graph_of(spec):
    return agglo.samples.from_spec(spec).graph


def number_of_components(graph, labels):
    return len(np.unique(graph.components(labels)))


def shape(graph, labels):
    return OBJECTIVES["shape"].value(graph, labels)


def slow_sides(odds, mass, quota):
    """Return sides and the number of parts of side 0 for one piece, cell by cell."""
    order = sorted(range(len(odds)), key=lambda i: odds[i])
    share = mass[odds < 0].sum() / mass.sum() * quota
    least = -(-quota // 4)
    lower = int(min(max(np.round(share), least), quota - least))
    sides = (odds >= 0).astype(int)
    if abs(share - lower) > 0.05 * min(lower, quota - lower):
        below = 0.0
        for i in order:
            sides[i] = below + 0.5 * mass[i] > lower / quota * mass.sum()
            below += mass[i]
    sides[order[:lower]] = 0
    sides[order[len(order) - (quota - lower) :]] = 1
    return sides, lower


def slow_partition(graph, parts, gnn):
    """Bisect piece by piece, each as a graph by itself."""
    labels, pieces = np.zeros(graph.n, int), [(np.arange(graph.n), parts, 0)]
    while pieces:
        cells, quota, first = pieces.pop()
        labels[cells] = first
        if quota > 1:
            odds = gnn.logits(graph.subgraph(cells, [0, len(cells)]))
            sides, lower = slow_sides(odds, graph.mass[cells], quota)
            pieces.append((cells[sides == 0], lower, first))
            pieces.append((cells[sides == 1], quota - lower, first + lower))
    return labels


@pytest.mark.parametrize(("spec", "parts"), [(SPECS[0], 2), (SPECS[0], 60), (SPECS[1], 60), ("brain", 7)])
def test_a_depth_at_once_is_a_piece_at_a_time(spec, parts):
    graph, gnn = graph_of(spec), PaperGNN()
    with torch.inference_mode():
        labels = bisect_to_parts(DeviceGraph.of(graph, "cpu"), parts, gnn._odds)
    assert np.array_equal(labels.numpy(), slow_partition(graph, parts, gnn))


@pytest.mark.parametrize("scale", [1e-40, 1.0, 1e40])
def test_features_are_those_of_inorm(scale):
    """Blocks of any order and size; a half square, whose second moments are equal, and stretched blocks."""
    mesh = agglo.samples.voronoi(400, seed=2)
    points = scale * (mesh.points * [1.0, 3.0] + 5.0)
    loops = mesh.boundary_loops
    graph = agglo.Mesh.from_polygons(points, (loops.loop_offsets, loops.vertices)).graph
    x, y = graph.centroids.T / scale
    blocks = np.where(x + y < 13.0, 0, np.where(x > 5.9, 1, 2))
    level, cells = graph.split(blocks)
    device = DeviceGraph.of(graph, "cpu")
    result = features(device, torch.from_numpy(cells.copy()), torch.from_numpy(level.block_ids.copy()), 3)
    assert np.allclose(result.numpy(), inorm(level), rtol=0, atol=1e-11)


def test_equal_moments_take_the_axes_of_fourth_moments():
    graph = graph_of("squares:n=8")
    cells = torch.arange(graph.n)
    result = features(DeviceGraph.of(graph, "cpu"), cells, torch.zeros_like(cells), 1).numpy()
    assert np.allclose(np.sort(np.abs(result)), np.sort(np.abs(inorm(graph))))


@given(st.integers(1, 300), st.integers(0, 2**32 - 1))
def test_sums_do_not_depend_on_the_order(n, seed):
    rng = np.random.default_rng(seed)
    values, groups = rng.normal(size=(n, 2)) * [1.0, 1e-30], rng.integers(0, 5, n)
    order = rng.permutation(n)
    one, other = (
        group_sums(torch.from_numpy(values[o]), torch.from_numpy(groups[o]), 5).numpy()
        for o in (np.arange(n), order)
    )
    assert np.array_equal(one, other)
    slow = np.array([values[groups == g].sum(0) for g in range(5)])
    assert np.allclose(one, slow, rtol=0, atol=n * np.abs(values).max(0) * 1e-12)


@given(st.integers(1, 8), st.integers(0, 2**32 - 1))
def test_components_are_those_of_the_graph(count, seed):
    graph = graph_of("voronoi:n=120,seed=1")
    labels = np.random.default_rng(seed).integers(0, count, graph.n)
    root = components(DeviceGraph.of(graph, "cpu"), torch.from_numpy(labels)).numpy()
    component = graph.components(labels)
    first = [np.flatnonzero(component == c)[0] for c in range(component.max() + 1)]
    assert np.array_equal(root, np.array(first)[component])


@given(st.integers(2, 30), st.integers(0, 2**32 - 1))
def test_every_side_has_a_cell_for_each_part(quota, seed):
    rng = np.random.default_rng(seed)
    n = quota + int(rng.integers(0, 5))
    mass = rng.choice([0.0, 1e-9, 1.0, 100.0], n)
    scores = rng.normal(size=n) + rng.choice([-9.0, 0.0, 9.0])
    sides, lower = cut(
        torch.from_numpy(scores),
        torch.from_numpy(mass),
        torch.zeros(n, dtype=torch.int64),
        torch.tensor([quota]),
    )
    assert 0 < lower < quota
    assert (sides == 0).sum() >= lower
    assert (sides == 1).sum() >= quota - lower


@given(st.integers(1, 30), st.integers(0, 2**32 - 1))
def test_mended_parts_are_connected_and_keep_their_largest_component(parts, seed):
    graph = graph_of("voronoi:n=120,seed=1")
    labels = np.random.default_rng(seed).permutation(graph.n) % parts
    mended = rounds.mend(DeviceGraph.of(graph, "cpu"), torch.from_numpy(labels), parts).numpy()
    assert np.array_equal(np.unique(mended), np.arange(parts))
    assert number_of_components(graph, mended) == parts
    component = graph.components(labels)
    sizes = np.bincount(component)[component]
    for part in range(parts):
        largest = sizes[labels == part].max()
        assert (np.bincount(component[(labels == part) & (mended == part)]) >= largest).any()


def start(graph, parts):
    """Return a connected partition with long parts."""
    device = DeviceGraph.of(graph, "cpu")
    strips = np.minimum(graph.centroids[:, 0].argsort().argsort() * parts // graph.n, parts - 1)
    return device, rounds.mend(device, torch.from_numpy(strips), parts)


@pytest.mark.parametrize("spec", SPECS)
def test_moves_change_inertia_and_interface_as_reckoned(spec):
    """Each gainful move by itself lowers inertia + price · interface, and no other move does."""
    graph, parts, price = graph_of(spec), 9, 0.3
    device, labels = start(graph, parts)
    sums = rounds._Sums.of(device, labels, parts)
    free = torch.zeros(parts), torch.full((parts,), torch.inf)
    moves = rounds._gainful(device, labels, sums, free, torch.tensor(price), labels < 0)

    def energy(labels):
        sums = rounds._Sums.of(device, labels, parts)
        return float(sums.inertia + price * sums.length)

    expected, before = {}, energy(labels)
    for i, home in enumerate(labels.tolist()):
        for target in set(labels.numpy()[graph.indices[graph.indptr[i] : graph.indptr[i + 1]]]) - {home}:
            after = labels.clone()
            after[i] = target
            if energy(after) < before - 1e-9 and (labels == home).sum() > 1:
                expected[i, home, target] = energy(after) - before
    assert {tuple(move) for move in moves.T.tolist()} == set(expected)
    gains = [expected[tuple(move)] for move in moves.T.tolist()]
    assert np.allclose(gains, sorted(gains), atol=1e-9)


@pytest.mark.parametrize("spec", SPECS)
def test_a_round_moves_cells_apart_that_leave_their_parts_connected(spec):
    graph, parts = graph_of(spec), 12
    device, labels = start(graph, parts)
    sums = rounds._Sums.of(device, labels, parts)
    free = torch.zeros(parts), torch.full((parts,), torch.inf)
    moves = rounds._independent(
        device, rounds._gainful(device, labels, sums, free, torch.tensor(0.0), labels < 0), parts
    )
    cells, homes, targets = moves.numpy()
    assert len(cells) > 1
    assert len(set(homes)) == len(set(targets)) == len(cells)
    moving = np.isin(np.arange(graph.n), cells)
    assert not any(moving[graph.indices[graph.indptr[i] : graph.indptr[i + 1]]].any() for i in cells)
    torn = rounds._torn(device, labels, moves, parts).numpy()
    for i, home, broken in zip(cells, homes, torn, strict=True):
        rest = (labels.numpy() == home) & (np.arange(graph.n) != i)
        pieces = len(np.unique(graph.components(rest.astype(int))[rest]))
        assert (pieces > 1) == broken


@pytest.mark.parametrize("spec", SPECS)
@pytest.mark.parametrize("parts", [5, 60])
def test_the_polish_lowers_the_objective_and_keeps_parts_connected(spec, parts):
    graph = graph_of(spec)
    device, labels = start(graph, parts)
    polished = rounds.polish(device, labels, parts).numpy()
    assert number_of_components(graph, polished) == parts == len(np.unique(polished))
    assert shape(graph, polished) < 0.95 * shape(graph, labels.numpy())
    before, after = (np.bincount(each, graph.mass) for each in (labels.numpy(), polished))
    assert (after >= 0.5 * before - 1e-9).all()
    again = rounds.polish(device, torch.from_numpy(polished), parts).numpy()
    assert shape(graph, again) <= shape(graph, polished) * (1.0 + 1e-12)


@settings(max_examples=15)
@given(st.integers(0, 2**32 - 1), st.data())
def test_partitions_have_exactly_the_connected_parts(seed, data):
    graph = graph_of(f"voronoi:n={data.draw(st.integers(1, 90))},seed={seed % 1000}")
    parts = data.draw(st.integers(1, graph.n))
    labels = PaperGNN().partition(graph, Target(parts=parts), seed=0)
    assert np.array_equal(np.unique(labels), np.arange(parts))
    assert number_of_components(graph, labels) == parts


def test_levels_are_nested_connected_and_exact():
    mesh = agglo.samples.random_triangles(1000, seed=5)
    hierarchy = agglo.agglomerate(mesh, bisector="gnn_paper", method="kway", n_parts=(250, 60, 9))
    assert hierarchy.parts == [250, 60, 9]
    fine, middle, coarse = hierarchy.levels
    for lower, upper in ((fine, middle), (middle, coarse)):
        assert len(np.unique(np.stack((lower, upper)), axis=1).T) == lower.max() + 1
    for labels in hierarchy.levels:
        assert number_of_components(mesh.graph, labels) == labels.max() + 1
    assert hierarchy.statistics["repairs"] == hierarchy.statistics["bisections"] == 0
    bisected = agglo.agglomerate(mesh, bisector="gnn_paper", n_parts=250).levels[0]
    assert shape(mesh.graph, fine) < shape(mesh.graph, bisected)


def test_sizes_are_kept():
    mesh = agglo.samples.voronoi(400, seed=5)
    hierarchy = agglo.agglomerate(mesh, bisector="gnn_paper", method="kway", h_star=0.3)
    assert mesh.graph.part_diameters(hierarchy.levels[0]).max() <= 0.3


def test_all_tensors_are_made_on_the_device_of_the_graph():
    """A tensor made on another default device cannot be combined with those of the graph."""
    graph, gnn = graph_of("voronoi:n=200,seed=3"), PaperGNN()
    with torch.device("meta"):
        labels = gnn.partition(graph, Target(parts=20), seed=0)
        sides = gnn.bisect_level(graph, np.zeros(1, np.uint64))
    assert np.array_equal(labels, gnn.partition(graph, Target(parts=20), seed=0))
    assert np.array_equal(sides, gnn.bisect_level(graph, np.zeros(1, np.uint64)))


@pytest.mark.skipif(not torch.cuda.is_available(), reason="torch finds no CUDA device")
def test_devices_agree():
    graph = graph_of("random_triangles:n=2000,seed=3")
    names = ("cpu", "cuda", "cuda")
    host, device, again = (PaperGNN(device=name).partition(graph, Target(parts=250), 0) for name in names)
    assert np.array_equal(device, again)
    assert np.mean(host == device) > 0.99


def test_options_are_checked(monkeypatch):
    with pytest.raises(OptionError, match="device must be cpu or cuda, given 'gpu'"):
        PaperGNN(device="gpu")
    monkeypatch.setattr(torch.cuda, "is_available", lambda: False)
    with pytest.raises(OptionError, match="torch finds no CUDA device; use device='cpu'"):
        PaperGNN(device="cuda")
    graph = graph_of("squares:n=4")
    with pytest.raises(OptionError, match="needs rounding=threshold, given rounding=sweep"):
        PaperGNN(rounding="sweep").partition(graph, Target(parts=2), 0)
    with pytest.raises(OptionError, match="needs a positive number of parts, given None"):
        PaperGNN().partition(graph, Target(h_star=0.5), 0)
    with pytest.raises(OptionError, match="2-D meshes only, given a 3-D one"):
        PaperGNN().partition(graph_of("boxes:n=2"), Target(parts=2), 0)
    with pytest.raises(PluginError, match="not finite"):
        bisect_to_parts(DeviceGraph.of(graph, "cpu"), 2, lambda x, _: x[:, 0] * torch.nan)
