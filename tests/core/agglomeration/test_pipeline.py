"""Pipeline: components by name, name with options, or object; keywords or TOML; what is refused and how."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
import pytest
from scipy import sparse

import agglo_core as agglo
from agglo_core import FileError, OptionError, Pipeline, PluginError, samples
from agglo_core.refine.connectivity import ConnectivityFixer
from agglo_core.refine.interface import InterfaceRefiner
from agglo_core.split.geometric import CoordinateBisection

MESH = samples.voronoi(60, seed=2)


class Halves:
    """The simple way, as a third party would write it."""

    def bisect(self, graph, rng):
        x = graph.centroids[:, 0]
        return x > np.median(x)


def same(one, other):
    assert len(one.levels) == len(other.levels)
    for a, b in zip(one.levels, other.levels, strict=True):
        np.testing.assert_array_equal(a, b)


def run(**options):
    return agglo.agglomerate(MESH, n_parts=[4, 9], **options)


def test_name_tuple_and_object_mean_the_same():
    same(run(bisector="coordinate"), run(bisector=("coordinate", {})))
    same(run(bisector="coordinate"), run(bisector=CoordinateBisection()))
    same(run(refiners=[("interface", {"floor": 0.5})]), run(refiners=[InterfaceRefiner(floor=0.5)]))
    same(run(fixer="connectivity"), run(fixer=ConnectivityFixer()))
    same(run(bisector="defaults/coordinate"), run(bisector="coordinate"))


def test_a_named_tuple_is_a_component_and_no_name_with_options():
    class Along(NamedTuple):
        axis: int = 0

        def bisect(self, graph, rng):
            x = graph.centroids[:, self.axis]
            return x > np.median(x)

    class Size(NamedTuple):
        unit: float = 1.0

        def measure(self, mesh, labels):
            return np.bincount(labels, mesh.cell_measures) / self.unit

    hierarchy = run(bisector=Along())
    same(hierarchy, run(bisector=Halves()))
    assert hierarchy.quality(0, metrics=[Size(0.5)])["Size"].sum() == pytest.approx(2.0)


def test_options_and_defaults_matter():
    same(
        run(),
        run(bisector="kmeans", refiners=("interface",), fixer="connectivity", method="recursive", seed=0),
    )
    plain, refined = run(refiners=()), run()
    assert any((a != b).any() for a, b in zip(plain.levels, refined.levels, strict=True))
    assert run(bisector=Halves()).parts == [9, 4]


def test_pipeline_object_runs_like_the_function():
    same(Pipeline(bisector="inertial", n_parts=(4, 9)).run(MESH), run(bisector="inertial"))


def test_several_refiners_run_in_order():
    calls = []

    class Spy:
        objective = "none"

        def __init__(self, name):
            self.name = name

        def refine(self, graph, labels, seeds, target):
            calls.append(self.name)
            return labels

    run(refiners=[Spy("a"), Spy("b")])
    assert calls[:2] == ["a", "b"]
    assert calls == ["a", "b"] * (len(calls) // 2)


def test_statistics_are_plain_data_that_say_how_it_went():
    statistics = run().statistics
    assert statistics["bisector"] == "kmeans"
    assert statistics["method"] == "recursive"
    assert statistics["bisections"] == 9 - 1
    assert statistics["fallbacks"] == 0
    assert statistics["depth"] >= 4
    assert {"order", "grow"} <= set(statistics["seconds"])
    by_depth = run(bisector="metis").statistics
    assert {"bisect", "refine", "fix", "split"} <= set(by_depth["seconds"])
    assert all(seconds >= 0 for seconds in statistics["seconds"].values())


def write(tmp_path, text):
    path = tmp_path / "run.toml"
    path.write_text(text, encoding="utf-8")
    return path


def test_toml_says_what_keywords_say(tmp_path):
    path = write(
        tmp_path,
        """
        refiners = ["interface", {name = "interface", floor = 0.5}]
        fixer = "connectivity"
        method = "recursive"
        seed = 5
        nested = false
        n_parts = [4, 9]
        [bisector]
        name = "kmeans_sklearn"
        n_init = 2
        """,
    )
    expected = run(
        refiners=["interface", ("interface", {"floor": 0.5})],
        seed=5,
        nested=False,
        bisector=("kmeans_sklearn", {"n_init": 2}),
    )
    same(agglo.agglomerate(MESH, config=path), expected)
    same(agglo.agglomerate(MESH, config=str(path)), expected)
    same(Pipeline.from_toml(path).run(MESH), expected)
    assert not agglo.agglomerate(MESH, config=path).nested


def test_arguments_win_over_the_file(tmp_path):
    path = write(tmp_path, 'bisector = "coordinate"\nn_parts = 5\nseed = 3\n')
    same(agglo.agglomerate(MESH, config=path, n_parts=[4, 9]), run(bisector="coordinate"))
    same(
        agglo.agglomerate(MESH, config=path, h_star=0.4),
        agglo.agglomerate(MESH, bisector="coordinate", h_star=0.4),
    )
    assert agglo.agglomerate(MESH, config=path, bisector="inertial").parts == [5]


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("bisektor = 'kmeans'", r"'bisektor' \(did you mean 'bisector'\?\); accepted: bisector, refiners"),
        ("bisector = 3", "bisector must be a name or a table with a name"),
        ("[bisector]\nn_init = 3", "bisector must be a name or a table with a name"),
        ("refiners = 'interface'", "refiners must be a list"),
        ("refiners = [3]", "refiners must be a name or a table"),
        ("bisector = ", "run.toml"),
        ("n_parts = 3\nn_parts = 4", "run.toml"),
    ],
)
def test_bad_toml_is_explained_with_the_file(tmp_path, text, message):
    with pytest.raises(FileError, match=message) as caught:
        Pipeline.from_toml(write(tmp_path, text))
    assert "run.toml" in str(caught.value)


def test_toml_that_cannot_be_read(tmp_path):
    with pytest.raises(FileError, match=r"nowhere\.toml"):
        Pipeline.from_toml(tmp_path / "nowhere.toml")
    with pytest.raises(FileError):
        Pipeline.from_toml(tmp_path)
    (tmp_path / "latin.toml").write_bytes(b"bisector = '\xe9'")
    with pytest.raises(FileError, match=r"latin\.toml"):
        Pipeline.from_toml(tmp_path / "latin.toml")


@pytest.mark.parametrize(
    "text",
    [
        "seed = 'x'",
        "seed = -1",
        "seed = true",
        "method = 'quick'",
        "method = 3",
        "nested = 'no'",
        "h_star = 'big'",
        "h_star = nan",
        "n_parts = 2\nh_star = 1.0",
    ],
)
def test_bad_values_in_toml(tmp_path, text):
    with pytest.raises((OptionError, FileError)):
        agglo.agglomerate(MESH, config=write(tmp_path, text))


@pytest.mark.parametrize(
    ("options", "error", "message"),
    [
        ({"bisector": "kmean"}, PluginError, r"no bisector is named 'kmean' \(did you mean 'kmeans'"),
        ({"refiners": ["nothing"]}, PluginError, "no refiner is named 'nothing'; available: .*interface"),
        ({"fixer": "nothing"}, PluginError, "no fixer is named 'nothing'"),
        (
            {"bisector": ("kmeans", {"colour": 1})},
            OptionError,
            "'kmeans'.* has no option 'colour'.*accepted: ",
        ),
        ({"bisector": ("kmeans_sklearn", {"n_init": 0})}, OptionError, "n_init"),
        ({"bisector": CoordinateBisection}, OptionError, "is not a bisector"),
        ({"bisector": 3}, OptionError, "3 is not a bisector"),
        ({"bisector": InterfaceRefiner()}, OptionError, "is not a bisector"),
        ({"bisector": ("kmeans",)}, OptionError, "bisector"),
        ({"bisector": ("kmeans", 3)}, OptionError, "bisector"),
        ({"bisector": ("kmeans", {}, 3)}, OptionError, "bisector"),
        ({"refiners": [None]}, OptionError, "None is not a refiner"),
        ({"refiners": "interface"}, OptionError, "refiners must be a sequence"),
        ({"fixer": object()}, OptionError, "is not a fixer"),
        ({"bisector": "spectral", "method": "kway"}, OptionError, "'spectral'.* has no k-way partition"),
        ({"bisector": Halves(), "method": "kway"}, OptionError, "Halves has no k-way partition"),
        ({"method": "quick"}, OptionError, "method must be 'recursive' or 'kway', given 'quick'"),
        ({"seed": -1}, OptionError, "seed"),
        ({"seed": 2**63}, OptionError, "seed"),
        ({"seed": 0.5}, OptionError, "seed"),
        ({"seed": True}, OptionError, "seed"),
        ({"nested": "yes"}, OptionError, "nested"),
    ],
)
def test_choices_that_make_no_sense(options, error, message):
    with pytest.raises(error, match=message):
        run(**options)


@pytest.mark.parametrize("seed", [2**63 - 1, np.int64(7)])
@pytest.mark.parametrize("bisector", ["kmeans", "kmeans_sklearn", "metis"])
def test_any_seed_will_do(bisector, seed):
    assert run(bisector=bisector, seed=seed).parts == [9, 4]


def test_only_meshes_and_graphs_are_agglomerated():
    with pytest.raises(OptionError, match=r"needs a Mesh or a Graph, given list$"):
        agglo.agglomerate([1, 2, 3])
    with pytest.raises(OptionError, match=r"given str: .* agglomerate\(read\(path\), …\)"):
        agglo.agglomerate("mesh.vtu")
    for points in (np.zeros((3, 2)), (np.zeros((3, 2)), [[0, 1, 2]])):
        with pytest.raises(OptionError, match=r"given (ndarray|tuple): .*Mesh\.from_polygons"):
            agglo.agglomerate(points)
    for matrix in (sparse.eye_array(3, format="csr"), sparse.csr_matrix((3, 3))):
        with pytest.raises(OptionError, match=r"given csr_\w+: .* agglomerate\(Graph\.from_scipy\(A\), …\)"):
            agglo.agglomerate(matrix)


def test_a_partitioner_alone_cannot_recurse():
    class Slices:
        def partition(self, graph, target, seed):
            return np.arange(graph.n) * target.parts // graph.n

    with pytest.raises(OptionError, match="Slices cannot bisect; use method='kway'"):
        run(bisector=Slices())
    assert run(bisector=Slices(), method="kway").parts == [9, 4]


def test_hierarchy_belongs_to_what_was_given():
    from_mesh, from_graph = run(), agglo.agglomerate(MESH.graph, n_parts=[4, 9])
    same(from_mesh, from_graph)
    assert from_mesh.fine is MESH
    assert from_mesh.mesh(0).n_cells == 9
    assert from_graph.fine is None
    with pytest.raises(agglo.MeshError, match="a graph without a mesh"):
        from_graph.mesh(0)
