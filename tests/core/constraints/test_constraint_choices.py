"""Constraints by name, as objects and in files; what they may not answer; what is not supported."""

from __future__ import annotations

import numpy as np
import pytest
from toy_constraints import Line, Regions, pairs

import agglo_core as agglo
from agglo_core import Component, Graph, OptionError, PluginError, hookimpl, samples


class Tagged:
    """Cells whose data of a name differ may not share a part."""

    def __init__(self, tag: str = "material") -> None:
        self.tag = tag

    def forbidden(self, graph):
        row, column = pairs(graph)
        return graph.data[self.tag][row] != graph.data[self.tag][column]


class Answer:
    """A constraint that returns what a function of the graph says."""

    def __init__(self, output):
        self.output = output

    def forbidden(self, graph):
        return self.output(graph)


def one_region_each(labels, regions):
    return all(len(set(regions[labels == part])) == 1 for part in range(labels.max() + 1))


class Declared:
    @hookimpl
    def agglo_components(self):
        return [
            Component(kind="constraint", name="material", target=f"{__name__}:Tagged"),
            Component(kind="constraint", name="line", target=f"{__name__}:Line"),
        ]


@pytest.fixture
def registry():
    registry = agglo.Registry()
    registry.register(Declared(), "toys")
    return registry


def own_parts(**others):
    """Objects, so that a bare registry will do."""
    from agglo_core.refine.connectivity import ConnectivityFixer
    from agglo_core.split.geometric import CoordinateBisection

    own = {"bisector": CoordinateBisection(), "refiners": (), "polish": False, "fixer": ConnectivityFixer()}
    return own | others


def tagged(graph):
    data = {"material": (graph.centroids[:, 1] > 0).astype(int)}
    arrays = (graph.indptr, graph.indices, graph.centroids)
    return Graph.from_arrays(*arrays, interface=graph.interface, measures=graph.measures, data=data)


def test_constraints_by_name_with_options_and_as_objects(registry):
    graph = tagged(samples.squares(6).graph)

    def run(*constraints):
        return agglo.agglomerate(graph, **own_parts(n_parts=6), constraints=constraints, registry=registry)

    for one, other in (("material", Tagged()), (("line", {"at": 0.1}), Line(at=0.1))):
        np.testing.assert_array_equal(run(one).levels[0], run(other).levels[0])
    assert one_region_each(run("material").levels[0], graph.data["material"])
    pipeline = agglo.Pipeline(**own_parts(n_parts=6), constraints=["material"])
    np.testing.assert_array_equal(pipeline.run(graph, registry).levels[0], run("material").levels[0])


def test_constraints_of_a_file(tmp_path, registry):
    path = tmp_path / "run.toml"
    path.write_text('n_parts = 6\nconstraints = ["material", {name = "line", at = 0.1}]\n')
    assert agglo.Pipeline.from_toml(path).constraints == ("material", ("line", {"at": 0.1}))
    graph = tagged(samples.squares(6).graph)
    from_file = agglo.agglomerate(graph, **own_parts(), config=path, registry=registry)
    check_against = agglo.agglomerate(graph, **own_parts(n_parts=6), constraints=[Tagged(), Line(at=0.1)])
    np.testing.assert_array_equal(from_file.levels[0], check_against.levels[0])
    none = agglo.agglomerate(graph, **own_parts(), config=path, constraints=(), registry=registry)
    np.testing.assert_array_equal(none.levels[0], agglo.agglomerate(graph, **own_parts(n_parts=6)).levels[0])
    with pytest.raises(PluginError, match="no constraint is named 'material'"):
        agglo.agglomerate(graph, config=path)


@pytest.mark.parametrize("method", ["recursive", "kway"])
def test_too_few_parts_say_how_many_there_must_be(method):
    mesh = samples.squares(6)
    four = Regions(2 * (mesh.cell_centroids[:, 0] > 0.5) + (mesh.cell_centroids[:, 1] > 0.5))
    with pytest.raises(OptionError, match=r"too few parts, 3: .*constraint Regions.* into 4 components"):
        agglo.agglomerate(mesh, constraints=[four], n_parts=(9, 3), method=method)
    assert agglo.agglomerate(mesh, constraints=[four], n_parts=(9, 4), method=method).parts == [9, 4]


def one_way(graph):
    answer = np.zeros(len(graph.indices), bool)
    answer[0] = True
    return answer


@pytest.mark.parametrize(
    ("output", "message"),
    [
        (
            lambda g: np.zeros(g.n, bool),
            r"forbidden returned shape \(36,\) of bool, expected \(120,\) of bool",
        ),
        (lambda g: np.zeros(len(g.indices)), r"forbidden returned shape \(120,\) of float64"),
        (lambda g: None, r"forbidden returned shape \(\) of object"),
        (one_way, r"forbidden has the edge from cell 0 to cell \d+, but not from \d+ to 0"),
        (lambda g: 1 / 0, "raised ZeroDivisionError"),
    ],
)
def test_bad_answers_are_named(output, message):
    with pytest.raises(PluginError, match=f"constraint Answer.*{message}"):
        agglo.agglomerate(samples.squares(6), constraints=[Answer(output)], n_parts=4)


@pytest.mark.parametrize(
    ("constraints", "message"),
    [
        ("line", "constraints must be a sequence"),
        ([3], "3 is not a constraint"),
        ([Line], "is not a constraint"),
    ],
)
def test_constraints_that_are_none(constraints, message):
    with pytest.raises(OptionError, match=message):
        agglo.agglomerate(samples.squares(4), constraints=constraints, n_parts=4)
