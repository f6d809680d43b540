"""Constraints: no part is joined across an edge that one of them forbids, in any mode, at any level."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

import agglo_core as agglo
from agglo_core import Component, Graph, OptionError, PluginError, hookimpl, samples

MODES = {
    "recursive": {},
    "not nested": {"nested": False},
    "merged": {"merge": True},
    "polished": {"post_refiners": ["interface"]},
    "merged and polished": {"merge": True, "post_refiners": ["interface"]},
    "k-way": {"method": "kway"},
    "k-way, not nested": {"method": "kway", "nested": False},
    "k-way, merged and polished": {"method": "kway", "merge": True, "post_refiners": ["interface"]},
    "metis": {"bisector": "metis", "method": "kway"},
    "inertial": {"bisector": "inertial", "refiners": ()},
}


def pairs(graph):
    return np.repeat(np.arange(graph.n), np.diff(graph.indptr)), graph.indices


class Regions:
    """Cells of different regions may not share a part."""

    def __init__(self, regions):
        self.regions = np.asarray(regions)

    def forbidden(self, graph):
        row, column = pairs(graph)
        return self.regions[row] != self.regions[column]


class Tagged:
    """The same, by the cell data of a name."""

    def __init__(self, tag: str = "material") -> None:
        self.tag = tag

    def forbidden(self, graph):
        row, column = pairs(graph)
        return graph.data[self.tag][row] != graph.data[self.tag][column]


class Line:
    """Nothing is joined across the line x = ``at``; ``above`` some height only."""

    def __init__(self, at: float = 0.5, above: float = -np.inf) -> None:
        self.at, self.above = at, above

    def forbidden(self, graph):
        centroids = graph.centroids + graph.origin
        right, high = centroids[:, 0] > self.at, centroids[:, 1] > self.above
        row, column = pairs(graph)
        return (right[row] != right[column]) & high[row] & high[column]


class Answer:
    """A constraint that returns what a function of the graph says."""

    def __init__(self, output):
        self.output = output

    def forbidden(self, graph):
        return self.output(graph)


def check(mesh, hierarchy, constraint):
    """Parts are connected without the forbidden edges, counts exact, sizes met, nested if it says so."""
    graph = mesh.graph
    row, column = pairs(graph)
    allowed = ~constraint.forbidden(graph)
    for labels, target in zip(hierarchy.levels, hierarchy.targets, strict=True):
        inside = allowed & (labels[row] == labels[column])
        assert components(graph.n, row[inside], column[inside]) == labels.max() + 1
        if "n_parts" in target:
            assert labels.max() + 1 == target["n_parts"]
        else:
            wide = graph.part_diameters(labels) > target["h_star"] * (1 + 1e-9)
            assert (np.bincount(labels)[wide] == 1).all()
    if hierarchy.nested:
        for level in range(len(hierarchy.levels) - 1):
            parents = hierarchy.parents(level)
            np.testing.assert_array_equal(parents[hierarchy.levels[level]], hierarchy.levels[level + 1])


def components(n, row, column):
    """Number of components by union and find."""
    root = list(range(n))

    def find(i):
        while root[i] != i:
            i = root[i]
        return i

    for i, j in zip(row.tolist(), column.tolist(), strict=True):
        root[find(i)] = find(j)
    return sum(root[i] == i for i in range(n))


def pieces(mesh, constraint):
    row, column = pairs(mesh.graph)
    allowed = ~constraint.forbidden(mesh.graph)
    return components(mesh.graph.n, row[allowed], column[allowed])


def one_region_each(labels, regions):
    return all(len(set(regions[labels == part])) == 1 for part in range(labels.max() + 1))


@pytest.mark.parametrize("mode", MODES)
@pytest.mark.parametrize("sample", ["squares:8", "voronoi:n=70,seed=3", "boxes:4", "tetrahedra:2"])
def test_no_part_crosses_in_any_mode(sample, mode):
    mesh = samples.from_spec(sample)
    regions = (mesh.cell_centroids[:, 0] > 0.45).astype(int) + 2 * (mesh.cell_centroids[:, 1] > 0.6)
    regions, line = Regions(regions), Line()
    for constraint in (regions, line):
        least = pieces(mesh, constraint)
        for target in ({"h_factor": (1.3, 2, 30)}, {"n_parts": (least + 9, least)}):
            options = dict(MODES[mode])
            if "n_parts" in target:
                options.pop("merge", None)
            hierarchy = agglo.agglomerate(mesh, constraints=[constraint], **options, **target)
            check(mesh, hierarchy, constraint)
    for labels in hierarchy.levels:
        assert one_region_each(labels, mesh.cell_centroids[:, 0] > 0.5)
    assert hierarchy.parts[-1] == 2


@settings(max_examples=60)
@given(st.data())
def test_random_regions(data):
    mesh = data.draw(st.sampled_from([samples.voronoi(50, 1), samples.disconnected(4), samples.boxes(3)]))
    kinds = data.draw(st.integers(1, 4))
    seed = data.draw(st.integers(0, 1000))
    regions = Regions(np.random.default_rng(seed).integers(0, kinds, mesh.n_cells))
    options = dict(MODES[data.draw(st.sampled_from(sorted(MODES)))])
    least = pieces(mesh, regions)
    if data.draw(st.booleans()):
        options.pop("merge", None)
        counts = st.lists(st.integers(least, mesh.n_cells), min_size=1, max_size=3)
        target = {"n_parts": data.draw(counts)}
    else:
        target = {"h_factor": data.draw(st.lists(st.floats(0.5, 12), min_size=1, max_size=3))}
    hierarchy = agglo.agglomerate(mesh, constraints=[regions], seed=seed, **options, **target)
    check(mesh, hierarchy, regions)
    assert all(one_region_each(labels, regions.regions) for labels in hierarchy.levels)


def test_a_region_is_agglomerated_as_if_it_were_alone():
    """What is joined to nothing is a mesh of its own: the outer boundary of a region is where it ends."""
    mesh = samples.squares(8)
    left = np.flatnonzero(mesh.cell_centroids[:, 0] < 0.5)
    both = agglo.agglomerate(mesh, constraints=[Line()], bisector="inertial", h_star=0.3).levels[0]
    graph = mesh.graph.subgraph(left, [0, len(left)])
    alone = agglo.agglomerate(graph, bisector="inertial", h_star=0.3).levels[0]
    assert len(set(zip(both[left], alone, strict=True))) == alone.max() + 1 == len(set(both[left]))


def test_several_constraints_hold_together():
    mesh = samples.squares(6)
    upper = Regions(mesh.cell_centroids[:, 1] > 0.5)
    hierarchy = agglo.agglomerate(mesh, constraints=[Line(), upper], h_factor=100)
    assert hierarchy.parts == [4]


def test_a_barrier_with_an_open_end_is_not_crossed_but_gone_around():
    mesh = samples.squares(8)
    barrier = Line(above=0.3)
    assert agglo.agglomerate(mesh, constraints=[barrier], n_parts=1).parts == [1]
    for mode in ({}, {"method": "kway"}):
        check(mesh, agglo.agglomerate(mesh, constraints=[barrier], n_parts=(12, 5, 1), **mode), barrier)


def test_the_hierarchy_keeps_the_whole_graph():
    mesh = samples.squares(6)
    hierarchy = agglo.agglomerate(mesh, constraints=[Line()], n_parts=4)
    assert hierarchy.graph is mesh.graph
    assert hierarchy.graph.coarsen(hierarchy.levels[0]).components().max() == 0


@pytest.mark.parametrize("options", [{}, {"method": "kway"}, {"bisector": "spectral", "n_parts": 9}])
def test_a_constraint_that_forbids_nothing_changes_nothing(options):
    mesh = samples.voronoi(60, seed=4)
    plain = agglo.agglomerate(mesh, **options)
    free = agglo.agglomerate(mesh, constraints=[Regions(np.zeros(60))], **options)
    for one, other in zip(plain.levels, free.levels, strict=True):
        np.testing.assert_array_equal(one, other)


# --- what is given, and how it is looked up ---------------------------------------------------------


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
    from agglo_core.components.fixers import ConnectivityFixer
    from agglo_core.components.geometric import CoordinateBisection

    return {"bisector": CoordinateBisection(), "refiners": (), "fixer": ConnectivityFixer(), **others}


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
        (one_way, r"forbidden has the edge from cell 0 to cell \d+, but not the way back"),
        (lambda g: 1 / 0, "raised ZeroDivisionError"),
    ],
)
def test_bad_answers_are_named(output, message):
    with pytest.raises(PluginError, match=f"constraint Answer.*{message}"):
        agglo.agglomerate(samples.squares(6), constraints=[Answer(output)], n_parts=4)


class Admits:
    def admissible(self, graph, labels):
        return np.ones(labels.max() + 1, bool)


class Finishes:
    def finished(self, graph, pieces):
        return np.ones(pieces.max() + 1, bool)


class Both(Line, Finishes):
    pass


@pytest.mark.parametrize(
    ("constraint", "method"), [(Admits(), "admissible"), (Finishes(), "finished"), (Both(), "finished")]
)
def test_what_is_not_supported_is_refused(constraint, method):
    name = type(constraint).__name__
    expected = rf"constraint {name} has {method}: so far agglomerate supports only forbidden"
    with pytest.raises(OptionError, match=expected):
        agglo.agglomerate(samples.squares(4), constraints=[constraint], n_parts=4)


@pytest.mark.parametrize(
    ("constraints", "message"),
    [("line", "constraints must be a sequence"), ([3], "3 is no constraint"), ([Line], "is no constraint")],
)
def test_constraints_that_are_none(constraints, message):
    with pytest.raises(OptionError, match=message):
        agglo.agglomerate(samples.squares(4), constraints=constraints, n_parts=4)


# --- graphs without edges ---------------------------------------------------------------------------


def test_outlines_stay_when_edges_are_taken_out():
    graph = samples.voronoi(40, seed=2).graph
    cut = graph.without_edges(Line().forbidden(graph))
    cut.check()
    assert len(cut.indices) < len(graph.indices)

    def outline(each):
        return each.boundary + each.to_scipy().sum(axis=1)

    np.testing.assert_allclose(outline(cut), outline(graph), rtol=1e-14)
    assert cut.boundary.sum() > graph.boundary.sum() + 0.9  # twice the line, which has the height of the mesh


def test_the_mask_of_edges_is_checked():
    graph = samples.squares(3).graph
    assert graph.without_edges(np.zeros(len(graph.indices), bool)) is graph
    for bad in (np.zeros(3, bool), np.zeros(len(graph.indices), int)):
        with pytest.raises(agglo.MeshError, match="removed must be a mask of shape"):
            graph.without_edges(bad)
