"""What every run guarantees, for every bisector, method and sample, checked without agglo's own kernels."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given, settings, strategies as st
from scipy.sparse import coo_array
from scipy.sparse.csgraph import connected_components
from scipy.spatial import ConvexHull
from scipy.spatial.distance import pdist

import agglo_core as agglo
from agglo_core import Mesh, samples

BISECTORS = ["kmeans", "kmeans_sklearn", "metis", "spectral", "coordinate", "inertial"]
METHODS = [(name, "recursive") for name in BISECTORS] + [("kmeans", "kway"), ("metis", "kway")]
SAMPLES = ["squares:6", "ring:n=30", "disconnected:4", "tetrahedra:2"]  # meshes() draws other families


def pieces(mesh: Mesh, labels) -> int:
    """Number of connected sets of cells with equal labels."""
    owner, neighbour = mesh.face_cells[mesh.face_cells[:, 1] >= 0].T
    kept = labels[owner] == labels[neighbour]
    links = coo_array((np.ones(kept.sum()), (owner[kept], neighbour[kept])), shape=(mesh.n_cells,) * 2)
    return connected_components(links, directed=False)[0]


def diameter(points) -> float:
    if len(points) > 60 and points.shape[1] == 2:
        points = points[ConvexHull(points).vertices]
    return float(pdist(points).max())


def check(mesh: Mesh, hierarchy) -> None:
    """Connected parts, exact counts, sizes met but by single cells, nested levels, tidy labels."""
    offsets, vertices = mesh.cell_vertices
    oversized = 0
    for labels, target in zip(hierarchy.levels, hierarchy.targets, strict=True):
        cells = np.bincount(labels)
        assert pieces(mesh, labels) == len(cells)
        first = np.unique(labels, return_index=True)[1]
        assert np.array_equal(np.sort(first), first)  # numbered by smallest cell, no gaps
        if "n_parts" in target:
            assert len(cells) == target["n_parts"]
            continue
        limit = target["h_star"] * (1 + 1e-9)
        points = np.repeat(np.arange(mesh.n_cells), np.diff(offsets))
        wide = [
            p
            for p in range(len(cells))
            if diameter(mesh.points[vertices[labels[points] == p]]) > limit * (1 + 1e-14)
        ]
        assert (cells[wide] == 1).all()
        oversized = max(oversized, len(wide))
    assert hierarchy.statistics["oversized_cells"] == oversized
    if hierarchy.nested:
        for level in range(len(hierarchy.levels) - 1):
            parents = hierarchy.parents(level)
            assert np.array_equal(parents[hierarchy.levels[level]], hierarchy.levels[level + 1])


@pytest.mark.parametrize("sample", SAMPLES)
@pytest.mark.parametrize(("bisector", "method"), METHODS)
def test_every_bisector_and_method_on_every_sample(bisector, method, sample):
    mesh = samples.from_spec(sample)
    chosen = (bisector, {"n_init": 1}) if bisector == "kmeans_sklearn" else bisector
    for target in ({"n_parts": (12, 7, 2)}, {"h_factor": (1.3, 2, 3)}):
        hierarchy = agglo.agglomerate(mesh, bisector=chosen, method=method, **target)
        check(mesh, hierarchy)
    again = agglo.agglomerate(mesh, bisector=chosen, method=method, **target)
    for one, other in zip(hierarchy.levels, again.levels, strict=True):
        np.testing.assert_array_equal(one, other)
    check(mesh, agglo.agglomerate(mesh, bisector=chosen, method=method, cells_per_part=(4, 9), nested=False))


@pytest.mark.parametrize("sample", SAMPLES)
@pytest.mark.parametrize("method", ["recursive", "kway"])
def test_merging_and_polishing_keep_the_guarantees(method, sample):
    mesh = samples.from_spec(sample)
    for target in ({"n_parts": (12, 7, 2)}, {"h_factor": (1.0, 1.5, 3)}):
        options = {"method": method, "merge": "h_factor" in target, "post_refiners": ["interface"]}
        plain = agglo.agglomerate(mesh, method=method, **target)
        hierarchy = agglo.agglomerate(mesh, **options, **target)
        check(mesh, hierarchy)
        assert all(a <= b for a, b in zip(hierarchy.parts[-1:], plain.parts[-1:], strict=True))


@st.composite
def meshes(draw) -> Mesh:
    """Small meshes of every family; some with cells knocked out: holes, pinches, loose components."""
    seed = draw(st.integers(0, 10**6))
    n = draw(st.integers(1, 90))
    side = max(1, round(np.sqrt(n)))
    mesh = draw(
        st.sampled_from(
            [
                lambda: samples.random_triangles(n, seed),
                lambda: samples.voronoi(n, seed),
                lambda: samples.triangles(side),
                lambda: samples.hexagons(side),
                lambda: samples.strip(n),
                lambda: samples.tetrahedra(max(1, side // 4)),
                lambda: samples.boxes(max(1, side // 3)),
            ]
        )
    )()
    if mesh.dim == 3:
        return mesh
    rng = np.random.default_rng(seed)
    kept = rng.random(mesh.n_cells) >= draw(st.sampled_from([0.0, 0.1, 0.4]))
    kept[rng.integers(mesh.n_cells)] = True
    if draw(st.booleans()):  # agglomerates as cells: not convex, with holes, several faces between two
        return mesh.coarsen(agglo.agglomerate(mesh, cells_per_part=3).levels[0])
    loops = mesh.boundary_loops
    cells = np.split(loops.vertices, loops.loop_offsets[1:-1])
    return Mesh.from_polygons(mesh.points, [cell for cell, keep in zip(cells, kept, strict=True) if keep])


@settings(max_examples=120)
@given(meshes(), st.data())
def test_random_meshes_and_targets(mesh, data):
    bisector, method = data.draw(st.sampled_from([m for m in METHODS if m[0] != "kmeans_sklearn"]))
    components = pieces(mesh, np.zeros(mesh.n_cells, int))
    count = st.integers(components, mesh.n_cells)
    target = data.draw(
        st.one_of(
            st.builds(lambda k: {"n_parts": k}, st.lists(count, min_size=1, max_size=3)),
            st.builds(lambda h: {"h_factor": h}, st.lists(st.floats(0.3, 12), min_size=1, max_size=3)),
        )
    )
    refiners = data.draw(st.sampled_from([("interface",), ()]))
    nested = data.draw(st.booleans())
    check(
        mesh,
        agglo.agglomerate(mesh, bisector=bisector, method=method, refiners=refiners, nested=nested, **target),
    )


@pytest.mark.slow
@pytest.mark.parametrize(("bisector", "method"), [m for m in METHODS if m[0] != "kmeans_sklearn"])
def test_the_brain(published, bisector, method):
    mesh = published("brain_holes")
    width = diameter(mesh.points[np.unique(mesh.face_vertices)])
    check(mesh, agglo.agglomerate(mesh, bisector=bisector, method=method, h_star=(0.1 * width, 0.2 * width)))
    components = int(mesh.graph.components().max()) + 1
    check(mesh, agglo.agglomerate(mesh, bisector=bisector, method=method, n_parts=(60, components)))


# --- exactness --------------------------------------------------------------------------------------


def moved(mesh: Mesh, angle: float, shift) -> Mesh:
    turn = np.array([[np.cos(angle), -np.sin(angle)], [np.sin(angle), np.cos(angle)]])
    loops = mesh.boundary_loops
    return Mesh.from_polygons(mesh.points @ turn.T + shift, (loops.loop_offsets, loops.vertices))


def assert_sixteen_squares(mesh: Mesh, bisector: str) -> None:
    labels = agglo.agglomerate(mesh, bisector=bisector, h_star=np.sqrt(2) / 4).levels[0]
    assert labels.max() + 1 == 16
    values = agglo.quality(mesh, labels, metrics=("UF", "CR", "CRc"))
    np.testing.assert_allclose(values["UF"], 1.0, atol=1e-4)
    np.testing.assert_allclose(values["CR"], np.sqrt(0.5), atol=1e-4)
    np.testing.assert_allclose(values["CRc"], np.sqrt(0.5), atol=1e-4)


@pytest.mark.parametrize("grid", ["squares", "triangles"])
@pytest.mark.parametrize("bisector", ["kmeans", "spectral", "inertial", "coordinate"])
def test_regular_grids_fall_into_sixteen_squares(bisector, grid):
    assert_sixteen_squares(samples.paper(grid), bisector)


@pytest.mark.parametrize("grid", ["squares", "triangles"])
@pytest.mark.parametrize("bisector", ["kmeans", "inertial"])
def test_turned_and_shifted_grids_give_sixteen_squares(bisector, grid):
    rng = np.random.default_rng(1)
    for angle, direction in 2 * np.pi * rng.random((8, 2)):
        shift = 1e6 * np.array([np.cos(direction), np.sin(direction)])
        assert_sixteen_squares(moved(samples.paper(grid), angle, shift), bisector)


# --- quality ----------------------------------------------------------------------------------------


def mean_quality(mesh: Mesh, **options):
    labels = agglo.agglomerate(mesh, **options).levels[0]
    values = agglo.quality(mesh, labels, metrics=("UF", "CR", "CRc"))
    return labels.max() + 1, *(values[name].mean() for name in ("UF", "CR", "CRc"))


@pytest.mark.parametrize("family", ["random_triangles:n=128", "voronoi:n=256"])
@pytest.mark.parametrize(("bisector", "least"), [("kmeans", (0.51, 0.42)), ("spectral", (0.48, 0.38))])
def test_roundness_on_fresh_meshes(bisector, least, family):
    fresh = [samples.from_spec(f"{family},seed={seed}") for seed in range(8)]
    values = [mean_quality(mesh, bisector=bisector, h_star=np.sqrt(2) / 4) for mesh in fresh]
    assert (np.mean(values, axis=0)[2:] >= least).all()


@pytest.mark.parametrize(("grid", "least"), [("random", 0.47), ("voronoi", 0.49)])
def test_roundness_on_the_papers_grids(grid, least):
    assert mean_quality(samples.paper(grid), h_star=np.sqrt(2) / 4)[2] >= least


def test_roundness_on_the_brain(published):
    mesh = published("brain_no_holes")
    width = diameter(mesh.points[np.unique(mesh.face_vertices)])
    parts, uniformity, ratio, centred = mean_quality(mesh, h_star=0.2 * width)
    assert parts <= 49
    assert uniformity >= 0.76
    assert ratio >= 0.59
    assert centred >= 0.53
