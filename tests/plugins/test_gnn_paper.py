"""The paper's network against slow references, its component by the laws, its training from a seed."""

from __future__ import annotations

import sys
from dataclasses import replace

import numpy as np
import pytest
from click.testing import CliRunner

import agglo_core as agglo
from agglo_core import FileError, OptionError, PluginError, functionals
from agglo_core.graph import Graph

torch = pytest.importorskip("torch")
pytest.importorskip("safetensors")

from agglo_gnn import model_file  # noqa: E402
from agglo_gnn.paper import custom, data as paper_data  # noqa: E402
from agglo_gnn.paper.bisector import WEIGHTS, PaperGNN  # noqa: E402
from agglo_gnn.paper.epochs import Recipe, Training  # noqa: E402
from agglo_gnn.paper.network import (  # noqa: E402
    Neighbours,
    PaperNetwork,
    expected_normalised_cut,
    inorm,
)
from agglo_gnn.paper.train import train_paper  # noqa: E402
from agglo_gnn.training.command import train  # noqa: E402
from agglo_gnn.training.loop import one_thread  # noqa: E402

TINY = Recipe(seed=3, meshes=6, validation=2, epochs=4, rate=1e-3)

NETS = """
import torch
from torch import nn

class Small(nn.Module):
    def __init__(self):
        super().__init__()
        self.first, self.second = nn.Linear(6, 8), nn.Linear(8, 2)
        self.register_buffer("scale", torch.ones(1))
    def forward(self, x, neighbours):
        h = torch.relu(self.first(torch.cat((x, neighbours.mean(x)), dim=1)))
        return self.scale * self.second(h)

class Three(Small):
    def forward(self, x, neighbours):
        return torch.zeros(len(x), 3)

class Batch(Small):
    def forward(self, x, neighbours):
        return super().forward(x - x.mean(dim=0), neighbours)

class Fails(Small):
    def forward(self, x, neighbours):
        return self.nothing

class Norm(Small):  # its own averages in use, those of the batch in training
    def __init__(self):
        super().__init__()
        self.norm = nn.BatchNorm1d(3)
    def forward(self, x, neighbours):
        return super().forward(self.norm(x), neighbours)

class Frozen(Norm):  # batch norm that never looks at the batch: its state is the only trouble
    def train(self, mode=True):
        super().train(mode)
        self.norm.eval()
        return self

class Dropping(Small):
    def forward(self, x, neighbours):
        return super().forward(nn.functional.dropout(x, 0.5, self.training), neighbours)

class Nothing(nn.Module):
    def forward(self, x, neighbours):
        return torch.zeros(len(x), 2)

class Unused(Small):
    def forward(self, x, neighbours):
        return x[:, 1:]

class NotANumber(Small):
    def forward(self, x, neighbours):
        return super().forward(x, neighbours) * torch.nan

class Blows(Small):  # in training only
    def forward(self, x, neighbours):
        return super().forward(x, neighbours) / (0.0 if self.training else 1.0)

class Counts(Small):
    def __init__(self):
        super().__init__()
        self.register_buffer("calls", torch.tensor(0))

class Infinite(Small):
    def __init__(self):
        super().__init__()
        self.register_buffer("most", torch.tensor(torch.inf))

class Extra(Small):
    def get_extra_state(self):
        return {"a": 1}

class Lazy(Small):
    def __init__(self):
        super().__init__()
        self.first = nn.LazyLinear(8)

class Grows(Small):
    def forward(self, x, neighbours):
        logits = super().forward(x, neighbours)
        self.scale = torch.ones(2)
        return logits

class Aside(Small):  # what is not kept may be of any type
    def __init__(self):
        super().__init__()
        self.register_buffer("index", torch.arange(3), persistent=False)
    def forward(self, x, neighbours):
        return super().forward(x[:, self.index], neighbours)
"""


@pytest.fixture
def nets(tmp_path, monkeypatch):
    """A folder with a module ``my_nets``, which is the current one."""
    (tmp_path / "my_nets.py").write_text(NETS)
    monkeypatch.chdir(tmp_path)
    yield tmp_path
    sys.modules.pop("my_nets", None)


def graph_of(spec):
    return agglo.samples.from_spec(spec).graph


def level():
    """Three pieces of different kinds and sizes in one graph."""
    mesh = agglo.samples.voronoi(150, seed=2)
    x, y = mesh.local_centroids.T
    return mesh.graph.split(mesh.graph.components((x > 0.1).astype(int) + (y > x)))[0]


def slow_forward(parameters, x, graph):
    """The network node by node in numpy, from the formulas."""
    for layer in range(4):
        result = []
        for i in range(graph.n):
            near = graph.indices[graph.indptr[i] : graph.indptr[i + 1]]
            own = parameters[f"own.{layer}.weight"] @ x[i] + parameters[f"own.{layer}.bias"]
            mean = np.mean([x[j] for j in near], axis=0) if len(near) else np.zeros(len(x[i]))
            result.append(np.tanh(own + parameters[f"near.{layer}.weight"] @ mean))
        x = np.array(result)
    for layer in range(3):
        x = x @ parameters[f"dense.{layer}.weight"].T + parameters[f"dense.{layer}.bias"]
        x = np.tanh(x) if layer < 2 else x
    return x


def test_the_network_has_the_papers_size():
    sizes = {name: p.numel() for name, p in PaperNetwork().named_parameters()}
    assert sum(v for k, v in sizes.items() if k.startswith(("own", "near"))) == 25_216  # "roughly 25k"
    assert sum(sizes.values()) == 27_578  # "approximately 28k"


def test_the_forward_pass_against_a_slow_reference():
    graph = level()
    network = PaperNetwork().double()
    x = inorm(graph)
    with torch.no_grad():
        fast = network(torch.from_numpy(x), Neighbours.of([graph])).numpy()
    slow = slow_forward(custom.arrays_of(network), x, graph)
    assert np.allclose(fast, slow, rtol=1e-10, atol=1e-12)


def test_the_loss_is_that_of_the_core_for_each_block():
    graph = level()
    logits = torch.from_numpy(np.random.default_rng(0).normal(size=(graph.n, 2)))
    neighbours = Neighbours.of([graph])
    losses = expected_normalised_cut(logits, neighbours).numpy()
    Y = torch.softmax(logits, dim=1).numpy()
    parts = np.split(Y, graph.offsets[1:-1])
    expected = [functionals.expected_normalised_cut(graph[b], parts[b]) for b in range(graph.n_blocks)]
    assert graph.n_blocks > 2
    assert np.allclose(losses, expected, rtol=1e-12)


def test_gradients_are_right():
    graph = graph_of("triangles:n=2")
    neighbours = Neighbours.of([graph])
    logits = torch.from_numpy(np.random.default_rng(1).normal(size=(graph.n, 2))).requires_grad_()
    assert torch.autograd.gradcheck(lambda z: expected_normalised_cut(z, neighbours), (logits,))


def test_neighbours_of_several_graphs_are_those_of_each():
    graphs = [graph_of("squares:n=3"), level(), graph_of("strip:n=1")]
    joined = Neighbours.of(graphs)
    x = [np.random.default_rng(k).normal(size=(graph.n, 2)) for k, graph in enumerate(graphs)]
    together = joined.mean(torch.from_numpy(np.concatenate(x))).numpy()
    alone = [Neighbours.of([g]).mean(torch.from_numpy(v)).numpy() for g, v in zip(graphs, x, strict=True)]
    assert np.array_equal(together, np.concatenate(alone))
    assert joined.n_blocks == sum(graph.n_blocks for graph in graphs)
    adjacency = graphs[0].to_scipy() > 0
    assert np.allclose(alone[0], (adjacency @ x[0]) / adjacency.sum(axis=1)[:, None])


def test_inorm_is_bounded_and_follows_the_mesh():
    mesh = agglo.samples.voronoi(80, seed=5)
    x = inorm(mesh.graph)
    assert x[:, 0].max() == 1.0
    assert x[:, 0].min() > 0
    assert np.abs(x[:, 1:]).max() == 1.0
    assert np.allclose(mesh.cell_measures @ x[:, 1:], 0, atol=1e-12)
    turn = np.array([[0.6, -0.8], [0.8, 0.6]])
    loops = mesh.boundary_loops
    moved = agglo.Mesh.from_polygons(
        30.0 * mesh.points @ turn.T + [500.0, -70.0], (loops.loop_offsets, loops.vertices)
    )
    assert np.allclose(inorm(moved.graph), x, atol=1e-9)


def test_inorm_lays_long_pieces_along_x():
    tall = Graph.from_arrays([0, 1, 3, 4], [1, 0, 2, 1], [[0.0, 0.0], [0.0, 1.0], [0.0, 2.0]])
    assert np.allclose(np.abs(inorm(tall)), [[1, 1, 0], [1, 0, 0], [1, 1, 0]])


def test_one_cell_and_cells_in_one_place_give_finite_features():
    assert np.isfinite(inorm(graph_of("squares:n=1"))).all()
    assert np.isfinite(inorm(Graph.from_arrays([0, 1, 2], [1, 0], np.zeros((2, 2))))).all()


def test_solids_are_refused():
    with pytest.raises(OptionError, match="2-D meshes only, given a 3-D one"):
        PaperGNN().bisect_level(graph_of("boxes:n=2"), np.zeros(1, np.uint64))


def test_the_shipped_weights_are_the_papers_model_and_their_log_is_there():
    arrays, header = model_file.load(WEIGHTS, architecture="paper")
    assert header["features"] == ["measure", "x", "y"]
    assert sum(array.size for array in arrays.values()) == 27_578
    log = WEIGHTS.with_suffix(".log").read_text().splitlines()
    assert log[0].startswith("# agglo train --preset paper")
    number, _, validation, one_sided = log[-1].split()
    assert int(number) == header["metrics"]["epoch"] == header["recipe"]["epochs"]
    assert float(validation) == pytest.approx(header["metrics"]["validation"], abs=1e-5)
    assert float(one_sided) == pytest.approx(header["metrics"]["one_sided"], abs=1e-3)


@pytest.mark.parametrize("rounding", ["threshold", "sweep"])
@pytest.mark.parametrize("spec", ["squares:n=16", "triangles:n=8", "voronoi:n=256,seed=8"])
def test_the_shipped_weights_split_in_two_with_a_short_cut(spec, rounding):
    graph = graph_of(spec)
    sides = PaperGNN(rounding=rounding).bisect_level(graph, np.zeros(1, np.uint64)) >= 0.5
    shares = np.bincount(sides.astype(int), graph.measures, minlength=2) / graph.measures.sum()
    assert shares.min() > 0.35
    assert functionals.normalised_cut(graph, sides.astype(int)) < 0.2


def test_a_level_is_its_blocks_to_the_side():
    graph = level()
    gnn = PaperGNN()
    together = gnn.bisect_level(graph, np.zeros(graph.n_blocks, np.uint64))
    alone = [gnn.bisect_level(graph[b], np.zeros(1, np.uint64)) for b in range(graph.n_blocks)]
    assert np.allclose(together, np.concatenate(alone), rtol=0, atol=1e-12)


def test_precisions_agree_but_for_rounding():
    graph = graph_of("voronoi:n=200,seed=1")
    double, single = (PaperGNN(precision=p).logits(graph) for p in ("double", "single"))
    assert np.allclose(double, single, atol=1e-3 * np.abs(double).max())
    assert not np.array_equal(double, single)


def test_one_sided_pieces_fall_back_and_are_counted(tmp_path):
    """Weights of zero leave every cell at one half: side 1, the whole piece."""
    arrays, header = model_file.load(WEIGHTS)
    path = tmp_path / "flat.safetensors"
    model_file.save(path, {name: np.zeros_like(array) for name, array in arrays.items()}, header)
    mesh = agglo.samples.squares(6)
    chosen = ("gnn_paper", {"weights": str(path)})
    done = agglo.agglomerate(mesh, bisector=chosen, n_parts=4)
    inertial = agglo.agglomerate(mesh, bisector="inertial", n_parts=4)
    assert done.statistics["fallbacks"] == done.statistics["bisections"] == 3
    assert np.array_equal(done.levels[0], inertial.levels[0])
    swept = agglo.agglomerate(mesh, bisector=("gnn_paper", {**chosen[1], "rounding": "sweep"}), n_parts=4)
    assert swept.statistics["fallbacks"] == 0


def test_options_are_checked(tmp_path):
    with pytest.raises(OptionError, match="rounding must be threshold or sweep, given 'round'"):
        PaperGNN(rounding="round")
    with pytest.raises(OptionError, match="precision must be double or single"):
        PaperGNN(precision="half")
    with pytest.raises(OptionError, match="needs weights=FILE"):
        PaperGNN(network="my_nets:Small")
    with pytest.raises(FileError, match="cannot be read"):
        PaperGNN(weights=str(tmp_path / "none.safetensors"))
    arrays, header = model_file.load(WEIGHTS)
    other = tmp_path / "other.safetensors"
    model_file.save(other, arrays, header | {"architecture": "custom x:Y"})
    with pytest.raises(FileError, match="is a model of 'custom x:Y', expected 'paper'"):
        PaperGNN(weights=str(other))
    arrays.pop("own.0.bias")
    model_file.save(other, arrays, header)
    with pytest.raises(FileError, match=r"lacks array 'own.0.bias'"):
        PaperGNN(weights=str(other))


def test_missing_torch_is_named(monkeypatch):
    monkeypatch.setitem(sys.modules, "torch", None)
    with pytest.raises(PluginError, match=r"'gnn_paper'.*needs torch, not installed here"):
        agglo.plugins.default().build("bisector", "gnn_paper")


def test_the_families_come_in_turn_within_the_sizes():
    graphs = list(paper_data.draw(16, np.random.default_rng(0)))
    again = list(paper_data.draw(16, np.random.default_rng(0)))
    assert all(np.array_equal(a.centroids, b.centroids) for a, b in zip(graphs, again, strict=True))
    sizes = np.array([graph.n for graph in graphs])
    assert (sizes > 0.8 * paper_data.CELLS[0]).all()
    assert (sizes < 1.2 * paper_data.CELLS[1]).all()
    assert len(set(sizes)) > 12
    assert all(np.isclose(graph.measures.sum(), 1.0) for graph in graphs)
    corners = [int(np.diff(graph.vertex_offsets).max()) for graph in graphs[:4]]
    assert corners[:3] == [4, 3, 3]
    assert corners[3] > 4


def test_random_pieces_are_connected_parts_of_their_mesh():
    graph = graph_of("voronoi:n=200,seed=4")
    rng = np.random.default_rng(0)
    pieces = [paper_data.random_piece(graph, rng) for _ in range(20)]
    whole = {tuple(c) for c in graph.centroids}
    for piece in pieces:
        assert piece.n < graph.n
        assert piece.components().max() == 0
        assert {tuple(c) for c in piece.centroids} <= whole
    assert min(piece.n for piece in pieces) < 30 < max(piece.n for piece in pieces)


def test_pieces_are_drawn_in_their_share():
    sizes = [graph.n for graph in paper_data.draw(12, np.random.default_rng(1), pieces=1.0)]
    assert min(sizes) < 50
    assert all(g.measures.sum() < 0.9 for g in paper_data.draw(8, np.random.default_rng(1), pieces=1.0))


def run(recipe, epochs=None):
    with one_thread():
        training = Training(PaperNetwork, recipe)
        return training, [epoch for epoch, _ in zip(training.epochs(), range(epochs or 99), strict=False)]


def test_training_lowers_the_loss_and_depends_on_the_seed_alone():
    before = torch.random.get_rng_state()
    (one, epochs), (two, same) = run(TINY), run(TINY)
    assert torch.equal(before, torch.random.get_rng_state())
    assert [epoch.number for epoch in epochs] == [1, 2, 3, 4]
    assert epochs[-1].loss < epochs[0].loss
    assert epochs == same
    first, second = custom.arrays_of(one.network), custom.arrays_of(two.network)
    assert all(np.array_equal(first[name], second[name]) for name in first)
    other = run(replace(TINY, seed=4, epochs=1))[1]
    assert other[0].loss != epochs[0].loss


def test_the_reported_losses_are_those_of_the_network():
    training, epochs = run(replace(TINY, epochs=1))
    fresh = list(paper_data.draw(TINY.validation, np.random.default_rng([TINY.seed, 1])))
    losses, one_sided = [], []
    rng = np.random.default_rng([TINY.seed, 2])
    for graph in fresh:
        for piece, told in ((graph, losses), (paper_data.random_piece(graph, rng), one_sided)):
            with torch.no_grad():
                logits = training.network(torch.from_numpy(inorm(piece)).float(), Neighbours.of([piece]))
            Y = torch.softmax(logits.double(), dim=1).numpy()
            cost = functionals.expected_normalised_cut(piece, Y)
            told.append(cost if told is losses else len(np.unique(Y[:, 1] >= 0.5)) < 2)
    assert epochs[0].validation == pytest.approx(np.mean(losses), rel=1e-5)
    assert epochs[0].one_sided == np.mean(one_sided)


def paper(folder, *arguments):
    return CliRunner().invoke(
        train,
        ["--preset", "paper", "--meshes", "6", "--rate", "1e-3", "--device", "cpu", *map(str, arguments)],
        catch_exceptions=True,
    )


def test_a_training_taken_up_again_ends_in_the_same_file(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    assert (
        paper(tmp_path, "--epochs", 3, "-o", "straight.safetensors", "--log", "straight.log").exit_code == 0
    )
    stop = ("--checkpoint", "c.safetensors", "-o", "resumed.safetensors", "--log", "resumed.log")
    assert paper(tmp_path, "--epochs", 1, *stop).exit_code == 0
    assert paper(tmp_path, "--epochs", 3, "--resume", *stop).exit_code == 0
    one, two = (tmp_path / name for name in ("straight.safetensors", "resumed.safetensors"))
    assert one.read_bytes() == two.read_bytes()
    logs = [(tmp_path / name).read_text().splitlines() for name in ("straight.log", "resumed.log")]
    assert logs[0][2:] == logs[1][2:]
    assert len(logs[0]) == 6
    assert logs[0][0].startswith("# agglo train --preset paper --output straight.safetensors --epochs 3")
    for change, reason in (
        (("--seed", 9), "seed=0 [(]now 9[)]"),
        (("--pieces", 0.5), "pieces=0.0 [(]now 0.5[)]"),
        ((), "has completed 3 epochs"),
    ):
        with pytest.raises(OptionError, match=reason):
            raise paper(tmp_path, "--epochs", 3, "--resume", *stop, *change).exception
    model_file.load(one, architecture="paper")
    stop = ("--checkpoint", one, "-o", "x.safetensors")
    with pytest.raises(FileError, match="is a model of 'paper', expected 'checkpoint of paper'"):
        raise paper(tmp_path, "--epochs", 9, "--resume", *stop).exception


def test_a_training_prints_one_line_per_epoch(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    done = paper(tmp_path, "--epochs", 2)
    assert "one-sided" in done.stderr
    assert len([line for line in done.stderr.splitlines() if line.split()[0] in ("1", "2")]) == 2
    assert "wrote paper.safetensors" in done.stdout
    assert paper(tmp_path, "--epochs", 1, "--quiet").output == ""


def test_your_own_network_is_trained_and_used(nets):
    recipe = Recipe(meshes=8, validation=2, epochs=2, rate=1e-2, pieces=0.5)
    before = list(sys.path)
    header = train_paper(nets / "mine.safetensors", recipe, network="my_nets:Small", device="cpu")
    assert header["architecture"] == "custom my_nets:Small"
    options = {"network": "my_nets:Small", "weights": "mine.safetensors", "rounding": "sweep"}
    mesh = agglo.samples.voronoi(60, seed=1)
    done = agglo.agglomerate(mesh, bisector=("gnn_paper", options), n_parts=5)
    assert done.levels[0].max() == 4
    with pytest.raises(FileError, match="is a model of 'custom my_nets:Small', expected 'paper'"):
        PaperGNN(weights="mine.safetensors")
    assert sys.path == before


@pytest.mark.parametrize(
    ("name", "reason"),
    [
        ("Three", r"returned shape \(23, 3\) for 23 cells, expected logits \(23, 2\)"),
        ("Batch", "depend on other blocks$"),
        ("Norm", "depend on other blocks in training: 'norm' is a BatchNorm1d"),
        ("Frozen", "model file: 'norm.num_batches_tracked' is int64, and model files hold real numbers"),
        ("Counts", "cannot be saved in a model file: 'calls' is int64.*persistent=False"),
        ("Infinite", "cannot be saved in a model file: 'most' has values that are not finite"),
        ("Extra", "cannot be saved in a model file: '_extra_state' is a dict"),
        ("Lazy", "'first.weight' has no shape before the first call"),
        ("Grows", "changes the shapes of its state when called: scale"),
        ("Nothing", "has no parameters to train"),
        ("Unused", "logits that do not depend on its parameters"),
        ("NotANumber", "returned logits that are not finite for a mesh of 23 cells"),
        ("Blows", "returned logits that are not finite"),
        ("Fails", "failed on two meshes: AttributeError"),
        ("Nobody", "cannot be imported"),
    ],
)
def test_networks_that_do_not_fit_are_refused(nets, name, reason):
    with pytest.raises(OptionError, match=reason):
        custom.network_class(f"my_nets:{name}")


@pytest.mark.parametrize("target", ["Called", "wipe", "argued", "Small_instance", "os.abort"])
def test_objects_that_build_no_network_are_not_called(nets, target):
    (nets / "my_nets.py").write_text(
        NETS
        + "\nimport os\nclass Called:\n    def __init__(self): open('called', 'w').close()\n"
        + "def argued(folder): open('called', 'w').close()\n"
        + "class Wiping:\n    def __call__(self): open('called', 'w').close()\n"
        + "wipe, Small_instance = Wiping(), Small()\n"
    )
    with pytest.raises(OptionError, match=r"expected a class of torch\.nn\.Module, or a function"):
        custom.network_class(f"my_nets:{target}")
    assert not (nets / "called").exists()


def test_a_function_may_build_the_network(nets):
    (nets / "my_nets.py").write_text(NETS + "\ndef small(width=8): return Small()\n")
    assert isinstance(custom.network_class("my_nets:small")(), torch.nn.Module)


def test_weights_are_read_before_code_is_imported(nets):
    (nets / "my_nets.py").write_text("open('imported', 'w').close()\n")
    (nets / "bad.safetensors").write_bytes(b"no model")
    for weights in ("missing.safetensors", "bad.safetensors"):
        with pytest.raises(FileError, match=weights):
            PaperGNN(weights=weights, network="my_nets:Small")
    with pytest.raises(FileError, match="is a model of 'paper', expected 'custom my_nets:Small'"):
        PaperGNN(weights=str(WEIGHTS), network="my_nets:Small")
    assert not (nets / "imported").exists()


def test_a_file_of_options_runs_no_network_unless_allowed(nets, agglo):
    recipe = Recipe(meshes=4, validation=1, epochs=1, rate=1e-2)
    train_paper(nets / "mine.safetensors", recipe, network="my_nets:Small", device="cpu")
    sys.modules.pop("my_nets")
    (nets / "run.toml").write_text(
        'n_parts = 3\n[bisector]\nname = "gnn_paper"\n'
        'network = "my_nets:Small"\nweights = "mine.safetensors"\n'
    )
    for command in ("run", "solve"):
        done = agglo(command, "squares:n=4", "--config", "run.toml")
        assert done.code == 2
        assert "network of bisector 'gnn_paper'" in done.err
        assert "--allow-code" in done.err
    assert "my_nets" not in sys.modules
    done = agglo("run", "squares:n=4", "--config", "run.toml", "--allow-code", "--quiet")
    assert (done.code, done.err) == (0, "")


@pytest.mark.parametrize("name", ["Small", "Dropping", "Aside"])
def test_networks_that_fit_are_written_and_read_back(nets, name):
    recipe = Recipe(meshes=4, validation=1, epochs=1, rate=1e-2)
    train_paper(nets / "mine.safetensors", recipe, network=f"my_nets:{name}", device="cpu")
    bisector = PaperGNN(weights="mine.safetensors", network=f"my_nets:{name}")
    assert np.isfinite(bisector.logits(graph_of("squares:n=4"))).all()


def test_a_trial_leaves_the_generators_alone(nets):
    before = torch.random.get_rng_state()
    custom.network_class("my_nets:Dropping")
    assert torch.equal(before, torch.random.get_rng_state())


@pytest.mark.parametrize("name", ["Nothing", "Norm", "NotANumber"])
def test_a_network_that_does_not_fit_is_one_line_and_no_file(nets, agglo, name):
    done = agglo("train", "--preset", "paper", "--network", f"my_nets:{name}", "--quiet")
    assert done.code == 2
    assert done.err.startswith(f"error: network 'my_nets:{name}'")
    assert done.err.count("\n") == 1
    assert not list(nets.glob("*.safetensors"))
