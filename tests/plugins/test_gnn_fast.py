"""The fast model: exact forward, cuts that obey geometry, squares, looking ahead, weights, training."""

from __future__ import annotations

import pickle
import subprocess
import sys

import numpy as np
import pytest

import agglo_core as agglo
from agglo_core import FileError, Graph, Mesh, OptionError, Target, samples
from agglo_core.arrays import frozen_float
from agglo_core.errors import AggloError
from agglo_gnn.plane.fast import SHAPES, FastGNN
from agglo_gnn.plane.features import FEATURES, rasterise
from agglo_gnn.plane.lookahead import look_ahead
from agglo_gnn.training.pieces import piece_graphs

rasterised = pytest.mark.slow
"""Tests of what takes rasters outside a bisection: two kernels of ten seconds are compiled for them alone."""


def sides_of(graph, bisector=None):
    return (bisector or FastGNN()).bisect_level(graph, np.zeros(graph.n_blocks, np.uint64))


def arrays(seed):
    rng = np.random.default_rng(seed)
    return {key: 0.3 * rng.standard_normal(shape) for key, shape in SHAPES.items()}


def cost(graph, sides):
    """cut · √A (1/A₁ + 1/A₂) + max(15, 4 √n) (1 − B/T)."""
    rows = np.repeat(np.arange(graph.n), np.diff(graph.indptr))
    cut = graph.interface[sides[rows] != sides[graph.indices]].sum() / 2
    area = np.bincount(sides, graph.measures)
    means = np.stack([np.bincount(sides, graph.measures * x) / area for x in graph.centroids.T], axis=1)
    mean = area @ means / area.sum()
    within = graph.measures @ ((graph.centroids - means[sides]) ** 2).sum(axis=1)
    total = graph.measures @ ((graph.centroids - mean) ** 2).sum(axis=1)
    return cut * np.sqrt(area.sum()) * (1 / area).sum() + max(15, 4 * np.sqrt(graph.n)) * within / total


def turned(mesh, angle, factor=1.0, shift=0.0):
    turn = np.array([[np.cos(angle), np.sin(angle)], [-np.sin(angle), np.cos(angle)]])
    loops = mesh.boundary_loops
    return Mesh.from_polygons(mesh.points @ turn * factor + shift, (loops.loop_offsets, loops.vertices))


def slow_direction(nodes, near, areas, features, net):
    """The network, written out bin by bin."""
    own1, other1, bias1, own2, other2, bias2, dense1, add1, dense2, add2, dense3, add3 = net

    def layer(given, own, other, bias):
        out = []
        for i, row in enumerate(near):
            around = given[row[row >= 0]]
            mean = around.mean(axis=0) if len(around) else np.zeros(given.shape[1])
            out.append(np.maximum(given[i] @ own + mean @ other + bias, 0))
        return np.array(out)

    hidden = layer(layer(nodes, own1, other1, bias1), own2, other2, bias2)
    x = np.concatenate((areas @ hidden, features))
    x = np.maximum(x @ dense1 + add1, 0)
    x = np.maximum(x @ dense2 + add2, 0)
    return x @ dense3 + add3


def kernel_directions(rasters, net):
    from agglo_gnn.plane.kernels import direction

    found = []
    for b, features in enumerate(rasters.blocks):
        rows = slice(rasters.node_offsets[b], rasters.node_offsets[b + 1])
        count = rows.stop - rows.start
        found.append(
            direction(count, rasters.nodes[rows], rasters.near[rows], rasters.areas[rows], features, net)
        )
    return np.array(found)


@pytest.fixture(scope="module")
def level() -> Graph:
    """Pieces of a Voronoi mesh."""
    mesh = samples.voronoi(500, 3)
    return mesh.graph.split(agglo.agglomerate(mesh, n_parts=4).levels[0])[0]


@rasterised
def test_the_kernel_is_the_network(level):
    rasters = rasterise(level)
    net = tuple(frozen_float(values) for values in arrays(1).values())
    slow = []
    for b, features in enumerate(rasters.blocks):
        rows = slice(rasters.node_offsets[b], rasters.node_offsets[b + 1])
        slow.append(
            slow_direction(rasters.nodes[rows], rasters.near[rows], rasters.areas[rows], features, net)
        )
    np.testing.assert_allclose(kernel_directions(rasters, net), slow, rtol=1e-10, atol=1e-12)


@rasterised
def test_the_kernel_agrees_with_torch(level):
    torch = pytest.importorskip("torch")
    from agglo_gnn.plane.network import network

    rasters = rasterise(level)
    values = arrays(2)
    owner = np.repeat(np.arange(level.n_blocks), np.diff(rasters.node_offsets))
    near = np.where(rasters.near >= 0, rasters.near + rasters.node_offsets[owner][:, None], -1)
    given = (rasters.nodes, near.astype(np.int64), rasters.areas, owner, rasters.blocks)
    tensors = [torch.tensor(np.array(each)) for each in given]
    there = network({key: torch.tensor(value) for key, value in values.items()}, *tensors).numpy()
    here = kernel_directions(rasters, tuple(frozen_float(value) for value in values.values()))
    np.testing.assert_allclose(here, there, rtol=1e-5, atol=1e-5)


@rasterised
def test_features_are_what_they_say(level):
    rasters = rasterise(level)
    assert len(FEATURES) == rasters.nodes.shape[1] + rasters.blocks.shape[1]
    for b in range(level.n_blocks):
        u, v = rasters.cells[level.offsets[b] : level.offsets[b + 1]].T
        w = rasters.shares[level.offsets[b] : level.offsets[b + 1]]
        orders = [(order - k, k) for order in (2, 3, 4) for k in range(order + 1)]
        moments = [(w * u**i * v**j).sum() for i, j in orders]
        np.testing.assert_allclose(rasters.blocks[b, :12], moments, atol=1e-12)
        assert rasters.blocks[b, 0] + rasters.blocks[b, 2] == pytest.approx(2 / 3)
        assert rasters.blocks[b, 0] >= rasters.blocks[b, 2]
        assert rasters.blocks[b, 3] >= -1e-12
        assert rasters.blocks[b, 6] >= -1e-12
        rows = slice(rasters.node_offsets[b], rasters.node_offsets[b + 1])
        assert rasters.areas[rows].sum() == pytest.approx(1)
        np.testing.assert_allclose(rasters.areas[rows] @ rasters.nodes[rows, :2], 0, atol=1e-12)
        near = rasters.near[rows]
        np.testing.assert_allclose(rasters.nodes[rows, 3], (near < 0).mean(axis=1))
        for i, j in np.argwhere(near >= 0):
            assert i in near[near[i, j]]


@pytest.mark.parametrize("n", [60, 300, 2000])
@pytest.mark.parametrize("angle", [0.3, np.pi / 3, 2.5])
def test_turning_scaling_and_shifting_change_nothing(n, angle):
    mesh = samples.voronoi(n, 5)
    one, other = (sides_of(m.graph) for m in (mesh, turned(mesh, angle, 40.0, 1e3)))
    assert np.array_equal(one, other) or np.array_equal(one, 1 - other)


def test_renumbering_changes_nothing():
    graph = samples.random_triangles(400, 2).graph
    order = np.random.default_rng(0).permutation(graph.n)
    one, other = sides_of(graph), sides_of(graph.subgraph(order, [0, graph.n]))
    assert np.array_equal(one[order], other) or np.array_equal(one[order], 1 - other)


@pytest.mark.parametrize("mesh", [*(samples.squares(n) for n in (16, 20, 24)), samples.paper("triangles")])
def test_squares_become_squares(mesh):
    labels = agglo.agglomerate(mesh, bisector=FastGNN(), h_star=np.sqrt(2) / 4).levels[0]
    quality = agglo.quality(mesh, labels)
    assert labels.max() == 15
    np.testing.assert_allclose(quality["UF"], 1)
    np.testing.assert_allclose(quality["CR"], np.sqrt(0.5), atol=1e-4)


def test_both_sides_are_there_whatever_the_weights_say(level):
    pieces = list(piece_graphs(np.random.default_rng(8), 300))
    for bisector in (FastGNN(), FastGNN(arrays(3)), FastGNN({k: 0 * v for k, v in arrays(0).items()})):
        for graph in pieces:
            ones = np.add.reduceat(sides_of(graph, bisector), graph.offsets[:-1])
            assert ((ones > 0) & (ones < np.diff(graph.offsets))).all()


@pytest.mark.parametrize("n", [20, 40, 90])
def test_small_blocks_cost_no_more_than_four_axes(n):
    from agglo_core.split.straight_cuts import SweepBisection

    for seed in range(5):
        graph = samples.voronoi(n, seed).graph
        four = SweepBisection(4).bisect_level(graph, np.zeros(1, np.uint64))
        assert cost(graph, sides_of(graph)) <= cost(graph, four) * (1 + 1e-9)


def test_the_network_points_to_the_cut():
    """With the output fixed to v, a long piece is cut along, which no axis would choose."""
    fixed = {key: 0.0 * value for key, value in arrays(0).items()}
    fixed["dense3.bias"] = np.array([0.0, 1.0])
    mesh = samples.voronoi(1200, 0)
    loops = mesh.boundary_loops
    long = Mesh.from_polygons(mesh.points * (3.0, 1.0), (loops.loop_offsets, loops.vertices)).graph
    along = sides_of(long, FastGNN(fixed)).astype(bool)
    x, y = long.centroids.T
    assert abs(y[along].mean() - y[~along].mean()) > 0.4
    assert abs(x[along].mean() - x[~along].mean()) < 0.2


def test_pieces_are_connected_and_of_the_sizes_said():
    for graph in piece_graphs(np.random.default_rng(1), 200):
        assert len(np.unique(graph.components())) == graph.n_blocks
        assert np.diff(graph.offsets).min() >= 10


@rasterised
def test_looking_ahead_needs_fewer_parts_of_the_size():
    h_star = np.sqrt(2) / 4
    counts = []
    for seed in range(4):
        mesh = samples.voronoi(256, seed)
        for bisector in (FastGNN(), FastGNN(lookahead=5)):
            counts.append(agglo.agglomerate(mesh, bisector=bisector, h_star=h_star).levels[0].max() + 1)
    assert sum(counts[1::2]) < 0.97 * sum(counts[::2])


@rasterised
def test_looking_ahead_treats_every_block_alone(level):
    together = look_ahead(level, FastGNN().fast_sides, 4, 0.2)
    alone = [look_ahead(level[b], FastGNN().fast_sides, 4, 0.2) for b in range(level.n_blocks)]
    np.testing.assert_array_equal(together, np.concatenate(alone))


@pytest.mark.parametrize(
    ("options", "words"),
    [
        ({"lookahead": -1}, "lookahead must be"),
        ({"lookahead": True}, "lookahead must be"),
        ({"weights": 7}, "must be a model file"),
        ({"weights": {"sage1.own": np.zeros(3)}}, "these names and shapes"),
    ],
)
def test_bad_options_are_refused(options, words):
    with pytest.raises(OptionError, match=words):
        FastGNN(**options)


def test_looking_ahead_needs_a_size_to_look_to():
    mesh = samples.voronoi(60, 1)
    with pytest.raises(AggloError, match=r"lookahead needs a target size.*parts \(6\)"):
        agglo.agglomerate(mesh, bisector=FastGNN(lookahead=5), n_parts=6)
    plain = FastGNN()
    assert plain.for_target(Target(parts=6)) is plain


@rasterised
def test_for_target_does_not_change_the_bisector(level):
    bisector = FastGNN(lookahead=4)
    told = bisector.for_target(Target(h_star=0.2))
    np.testing.assert_array_equal(sides_of(level, told), look_ahead(level, bisector.fast_sides, 4, 0.2))
    np.testing.assert_array_equal(sides_of(level, bisector), bisector.fast_sides(level))


def test_weights_of_the_plane_are_refused_in_space():
    with pytest.raises(OptionError, match="for 2-D meshes, given a 3-D one"):
        sides_of(samples.boxes(3).graph, FastGNN(arrays(1)))


def test_bad_model_files_are_refused(tmp_path):
    from agglo_gnn.plane.fast import _WEIGHTS

    whole = (_WEIGHTS / "fast.safetensors").read_bytes()
    for content in (whole[:-50], pickle.dumps({"a": 1}), b"", whole[:200] + b"\0" * 40 + whole[240:]):
        file = tmp_path / "bad.safetensors"
        file.write_bytes(content)
        with pytest.raises(FileError, match=r"bad\.safetensors"):
            FastGNN(str(file))
    with pytest.raises(FileError, match="nowhere"):
        FastGNN("nowhere.safetensors")


def test_inference_does_not_import_torch():
    script = """
import sys
sys.modules["torch"] = None
import numpy as np
from agglo_core import samples
from agglo_gnn.plane.fast import FastGNN
FastGNN().bisect_level(samples.squares(12).graph, np.zeros(1, np.uint64))
"""
    subprocess.run([sys.executable, "-c", script], check=True)


@rasterised
def test_training_repeats_itself_and_starts_from_inertial_bisection():
    pytest.importorskip("torch")
    from agglo_gnn.plane.network import initial_parameters
    from agglo_gnn.plane.train import train_fast

    seen = []
    one, metrics = train_fast(5, steps=4, pieces=60, validation=40, progress=lambda *now: seen.append(now))
    two, _ = train_fast(5, steps=4, pieces=60, validation=40)
    assert {key: value.shape for key, value in one.items()} == dict(SHAPES)
    for key in one:
        np.testing.assert_array_equal(one[key], two[key])
    assert metrics["ratio"] < 1
    assert seen == []  # every hundred steps
    np.testing.assert_array_equal(initial_parameters(5)["dense3.weight"], 0)
    np.testing.assert_array_equal(initial_parameters(5)["dense3.bias"], [1, 0])
    with pytest.raises(OptionError, match="1 or more"):
        train_fast(0, steps=0)
