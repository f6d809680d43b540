"""Meshes, graphs and levels through shapely, GeoJSON, networkx and pyvista and back."""

from __future__ import annotations

import json
import subprocess
import sys
from dataclasses import replace

import networkx as nx
import numpy as np
import pytest
import shapely
from hypothesis import given, settings, strategies as st

from agglo_core import Graph, Hierarchy, Mesh, MeshError, OptionError, agglomerate, quality, samples
from agglo_core.interchange import (
    from_geojson,
    graph_from_networkx,
    graph_to_networkx,
    mesh_from_shapely,
    mesh_to_shapely,
    to_geojson,
    to_pyvista,
)
from agglo_core.io.levels import split_levels


def neighbours(mesh: Mesh) -> np.ndarray:
    """Dense matrix of interfaces."""
    return mesh.graph.to_scipy().toarray()


def same(first: Mesh, second: Mesh) -> bool:
    """Whether cells, faces, measures, interfaces and tags agree, whatever the numbers of points."""
    assert first.n_faces == second.n_faces
    np.testing.assert_allclose(second.cell_measures, first.cell_measures, rtol=1e-13)
    np.testing.assert_allclose(second.cell_centroids, first.cell_centroids, rtol=1e-12, atol=1e-13)
    np.testing.assert_array_equal(second.cell_diameters, first.cell_diameters)
    np.testing.assert_allclose(neighbours(second), neighbours(first), rtol=1e-13, atol=1e-15)
    assert first.cell_tags.keys() == second.cell_tags.keys()
    return all(np.array_equal(first.cell_tags[name], second.cell_tags[name]) for name in first.cell_tags)


def boxes(*corners: tuple[float, float, float, float]) -> list[shapely.Polygon]:
    return [shapely.box(*box) for box in corners]


# -- shapely ---------------------------------------------------------------------------------------
def test_squares_to_shapely() -> None:
    cells = mesh_to_shapely(samples.squares(4))
    assert cells.shape == (16,)
    assert shapely.is_valid(cells).all()
    assert shapely.coverage_is_valid(cells)
    np.testing.assert_allclose(shapely.area(cells), 1 / 16)
    assert shapely.is_ccw(shapely.get_exterior_ring(cells)).all()


@pytest.mark.parametrize("name", ["squares:5", "triangles:4", "voronoi:n=60,seed=2", "hexagons:5", "ring:12"])
def test_samples_survive_shapely(name: str) -> None:
    mesh = replace(samples.from_spec(name), name="")
    mesh = replace(mesh, cell_tags={"material": np.arange(mesh.n_cells) % 3})
    back = mesh_from_shapely(mesh_to_shapely(mesh), cell_tags=mesh.cell_tags, strict=True)
    assert same(mesh, back)
    assert not back.repairs


@given(n=st.integers(3, 8), k=st.integers(1, 20), triangles=st.booleans(), seed=st.integers(0, 10**6))
@settings(max_examples=30)
def test_any_partition_survives_shapely(n: int, k: int, triangles: bool, seed: int) -> None:
    """Random labels give holes, islands in holes, pinches and disconnected agglomerates."""
    fine = samples.triangles(n) if triangles else samples.squares(n)
    labels = np.unique(np.random.default_rng(seed).integers(0, k, fine.n_cells), return_inverse=True)[1]
    coarse = replace(fine.coarsen(labels), name="")
    polygons = mesh_to_shapely(coarse)
    assert shapely.is_valid(polygons).all()
    merged = [shapely.union_all(mesh_to_shapely(fine)[labels == i]) for i in range(coarse.n_cells)]
    assert shapely.equals(polygons, merged).all()
    assert same(coarse, mesh_from_shapely(polygons, strict=True))


def test_holes_islands_and_pinches_are_told_apart() -> None:
    ring_and_core = np.ones((5, 5), int)
    ring_and_core[1:4, 1:4] = 0
    ring_and_core[2, 2] = 1  # an island in the hole of its own cell
    pinched = np.zeros((4, 4), int)
    pinched[1, 1] = pinched[2, 2] = 1  # two holes that touch: one hole of two pieces is not valid
    diagonal = np.eye(2, dtype=int)
    for labels, kinds, holes in (
        (ring_and_core, ["Polygon", "MultiPolygon"], [1, 1]),
        (pinched, ["Polygon", "MultiPolygon"], [2, 0]),
        (diagonal, ["MultiPolygon", "MultiPolygon"], [0, 0]),
    ):
        mesh = samples.squares(len(labels))
        corners = mesh.cell_centroids // (1 / len(labels))
        polygons = mesh_to_shapely(mesh.coarsen(labels[tuple(corners.astype(int).T)]))
        assert [polygon.geom_type for polygon in polygons] == kinds
        assert shapely.is_valid(polygons).all()
        parts, item = shapely.get_parts(polygons, return_index=True)
        found = np.bincount(item, shapely.get_num_interior_rings(parts), minlength=len(polygons))
        assert found.tolist() == holes


def test_holes_in_are_exact() -> None:
    frame = shapely.box(0, 0, 4, 4).difference(shapely.box(1, 1, 2, 2)).difference(shapely.box(2, 2, 3, 3))
    mesh = mesh_from_shapely([frame, shapely.box(1, 1, 2, 2)])
    assert mesh.cell_measures.tolist() == [14, 1]
    assert neighbours(mesh).tolist() == [[0, 4], [4, 0]]
    assert mesh.graph.boundary.tolist() == [20, 0]
    assert mesh_from_shapely([frame]).cell_centroids.tolist() == [[2, 2]]


def test_a_hole_that_touches_its_shell_shares_the_vertex() -> None:
    hole = [(2, 0), (3, 1), (2, 2), (1, 1)]
    frame = shapely.Polygon(shapely.box(0, 0, 4, 4).exterior, [hole])
    mesh = mesh_from_shapely([frame, shapely.Polygon(hole)], strict=True)
    assert mesh.cell_measures.tolist() == [14, 2]
    assert mesh.repairs == {"hanging vertices inserted": 1}
    assert shapely.equals(mesh_to_shapely(mesh), [frame, shapely.Polygon(hole)]).all()


def test_orientation_repeated_points_and_constant_z_do_not_matter() -> None:
    plain = [[(0, 0), (1, 0), (1, 1), (0, 1)], [(1, 0), (2, 0), (2, 1), (1, 1)]]
    odd = [
        shapely.Polygon([(0, 0, 7), (0, 1, 7), (0, 1, 7), (1, 1, 7), (1, 0, 7)]),
        shapely.Polygon([(1, 0), (2, 0), (2, 1), (1, 1), (1, 1)]),
    ]
    assert same(mesh_from_shapely([shapely.Polygon(loop) for loop in plain]), mesh_from_shapely(odd))


def test_a_multipolygon_is_one_cell_or_split_by_its_owner() -> None:
    pair = shapely.MultiPolygon(boxes((0, 0, 1, 1), (2, 0, 3, 1)))
    middle = shapely.box(1, 0, 2, 1)
    mesh = mesh_from_shapely([pair, middle])
    assert mesh.cell_measures.tolist() == [2, 1]
    assert neighbours(mesh).tolist() == [[0, 2], [2, 0]]
    pieces, item = shapely.get_parts([pair, middle], return_index=True)
    split = mesh_from_shapely(pieces, cell_tags={"item": item})
    assert split.cell_tags["item"].tolist() == [0, 0, 1]
    assert split.coarsen(split.cell_tags["item"]).cell_measures.tolist() == [2, 1]


# -- vertices that neighbours do not share -----------------------------------------------------------
def test_hanging_vertices_are_inserted_and_counted() -> None:
    mesh = mesh_from_shapely(boxes((0, 0, 2, 2), (2, 0, 3, 1), (2, 1, 3, 2)), strict=True)
    assert neighbours(mesh)[0].tolist() == [0, 1, 1]
    assert mesh.repairs == {"hanging vertices inserted": 1}
    assert np.diff(mesh.boundary_loops.loop_offsets).tolist() == [5, 4, 4]


def test_edges_that_overlap_in_part_are_split_on_both_sides() -> None:
    mesh = mesh_from_shapely(boxes((0, 0, 1, 3), (1, 1, 2, 5)))
    assert neighbours(mesh).tolist() == [[0, 2], [2, 0]]
    assert mesh.repairs == {"hanging vertices inserted": 2}


@given(seed=st.integers(0, 10**6), angle=st.floats(0, 6.3), shift=st.sampled_from([0.0, 1e3, 1e6]))
@settings(max_examples=25)
def test_random_tilings_in_any_position_fit_together(seed: int, angle: float, shift: float) -> None:
    """Guillotine cuts: T-junctions everywhere, rounded by a rotation and a shift."""
    rng = np.random.default_rng(seed)
    tiles = [(0.0, 0.0, 1.0, 1.0)]
    for _ in range(15):
        x0, y0, x1, y1 = tiles.pop(int(np.argmax([(t[2] - t[0]) * (t[3] - t[1]) for t in tiles])))
        cut = rng.uniform(0.3, 0.7)
        if rng.random() < 0.5:
            middle = x0 + cut * (x1 - x0)
            tiles += [(x0, y0, middle, y1), (middle, y0, x1, y1)]
        else:
            middle = y0 + cut * (y1 - y0)
            tiles += [(x0, y0, x1, middle), (x0, middle, x1, y1)]
    c, s = np.cos(angle), np.sin(angle)
    exact = mesh_from_shapely(boxes(*tiles))
    moved = shapely.transform(boxes(*tiles), lambda xy: xy @ [[c, s], [-s, c]] + shift)
    mesh = mesh_from_shapely(moved)
    np.testing.assert_allclose(neighbours(mesh), neighbours(exact), atol=1e-8)
    np.testing.assert_allclose(mesh.graph.boundary.sum(), 4, atol=1e-8)
    np.testing.assert_allclose(exact.graph.boundary.sum(), 4, atol=1e-12)


def test_the_tolerance_closes_what_rounded_coordinates_left_open() -> None:
    rng = np.random.default_rng(0)
    exact = mesh_to_shapely(samples.hexagons(4))
    rough = [
        shapely.Polygon(np.add(cell.exterior.coords[:-1], rng.uniform(-1e-7, 1e-7, 2))) for cell in exact
    ]
    assert not neighbours(mesh_from_shapely(rough)).any()
    closed = mesh_from_shapely(rough, tolerance=1e-6, strict=True)
    np.testing.assert_allclose(neighbours(closed), neighbours(samples.hexagons(4)), atol=1e-5)
    assert closed.repairs["close points merged"] > 0


@pytest.mark.parametrize(
    ("polygons", "message"),
    [
        ([], "the mesh is empty"),
        (shapely.box(0, 0, 1, 1), "expected a list of polygons, given one Polygon"),
        ([shapely.box(0, 0, 1, 1), None], "cell 1: expected shapely polygons, given NoneType"),
        ([shapely.box(0, 0, 1, 1), "x"], "cell 1: expected shapely polygons, given str"),
        ([shapely.LineString([(0, 0), (1, 1)])], "cell 0: expected a Polygon or MultiPolygon, given a Line"),
        ([shapely.Polygon()], "cell 0: empty"),
        ([shapely.Polygon([(0, 0), (1, 1), (1, 0), (0, 1)])], "cell 0: invalid, Self-intersection"),
        ([shapely.Polygon([(0, 0, 0), (1, 0, 0), (0, 1, 1)])], "surface"),
        ([shapely.box(0, 0, 1, 1), shapely.box(0, 0, 1, 1, ccw=False)], "cells 0, 1 are the same polygon"),
        (boxes((0, 0, 1, 1), (1, 0, 2, 1), (0.5, 0, 1, 1)), "cells 0, 1, 2 overlap: more than two"),
    ],
)
def test_bad_polygons_are_named(polygons: list[shapely.Polygon], message: str) -> None:
    with pytest.raises(MeshError, match=message):
        mesh_from_shapely(polygons)


@pytest.mark.filterwarnings("ignore:invalid value")  # shapely's word on NaN
def test_points_that_are_not_finite_are_refused() -> None:
    with pytest.raises(MeshError, match="cell 0: invalid, Invalid Coordinate"):
        mesh_from_shapely([shapely.Polygon([(0, 0), (1, 0), (np.nan, 1)])])


def test_overlaps_are_refused_if_strict(caplog: pytest.LogCaptureFixture) -> None:
    polygons = boxes((0, 0, 2, 1), (1, 0, 3, 1))
    assert mesh_from_shapely(polygons).repairs["overlapping edges left apart"] == 2
    assert "2 pairs of cells overlap at an edge, such as cells 0 and 1" in caplog.text
    with pytest.raises(MeshError, match="cells 0, 1: an overlap or a narrow gap"):
        mesh_from_shapely(polygons, strict=True)


def test_polygons_below_the_tolerance_are_refused() -> None:
    with pytest.raises(MeshError, match=r"cell 1: a ring is smaller than the tolerance 0\.1"):
        mesh_from_shapely(boxes((0, 0, 1, 1), (2, 0, 2.01, 0.01)), tolerance=0.1)
    flat = shapely.Polygon([(2, 0), (4, 0), (3, 0.05)])
    for tags in (None, {"a": [1, 2]}):
        with pytest.raises(MeshError, match=r"cell 1: nothing is left of it at the tolerance 0\.1"):
            mesh_from_shapely([shapely.box(0, 0, 1, 1), flat], tolerance=0.1, cell_tags=tags)


def test_3d_meshes_are_refused() -> None:
    with pytest.raises(MeshError, match="2-D mesh"):
        mesh_to_shapely(samples.boxes(1))


# -- GeoJSON ---------------------------------------------------------------------------------------
@pytest.fixture(scope="module")
def run() -> tuple[Mesh, Hierarchy]:
    mesh = samples.voronoi(80, seed=5)
    mesh = replace(mesh, cell_tags={"material": np.arange(80) % 4})
    return mesh, agglomerate(mesh, bisector="kmeans", n_parts=(10, 3))


def test_geojson_text_keeps_measures_tags_and_levels(run: tuple[Mesh, Hierarchy]) -> None:
    mesh, hierarchy = run
    text = json.dumps(to_geojson(mesh, hierarchy), allow_nan=False)
    back, levels = split_levels(from_geojson(json.loads(text), strict=True))
    assert same(mesh, back)
    assert back.name == mesh.name
    assert sorted(map(tuple, back.points.tolist())) == sorted(map(tuple, mesh.points.tolist()))  # to the bit
    assert [a.tolist() for a in levels.levels] == [a.tolist() for a in hierarchy.levels]
    for level in (0, 1):
        assert same(hierarchy.mesh(level), from_geojson(to_geojson(hierarchy.mesh(level))))


def test_features_carry_number_tags_level_and_values(run: tuple[Mesh, Hierarchy]) -> None:
    mesh, hierarchy = run
    coarse = hierarchy.mesh(0)
    values = quality(mesh, hierarchy.levels[0], metrics=("UF",))["UF"]
    feature = to_geojson(coarse, properties={"UF": values, "gap": np.full(10, np.nan)})["features"][4]
    assert feature["type"] == "Feature"
    assert feature["id"] == 4
    assert feature["properties"] == {"UF": values[4], "gap": None}
    np.testing.assert_allclose(
        shapely.geometry.shape(feature["geometry"]).area, coarse.cell_measures[4], rtol=1e-13
    )
    assert to_geojson(mesh, hierarchy)["features"][9]["properties"] == {
        "material": 1,
        "level_0": int(hierarchy.levels[0][9]),
        "level_1": int(hierarchy.levels[1][9]),
    }


def test_an_earlier_hierarchy_is_not_exported(run: tuple[Mesh, Hierarchy]) -> None:
    mesh, hierarchy = run
    stale = replace(
        mesh, cell_tags={"level_5": np.arange(mesh.n_cells), "level_set": mesh.cell_tags["material"]}
    )
    properties = to_geojson(stale, hierarchy)["features"][0]["properties"]
    assert list(properties) == ["level_set", "level_0", "level_1"]
    assert list(to_geojson(stale)["features"][0]["properties"]) == ["level_5", "level_set"]


def test_only_whole_properties_become_tags(caplog: pytest.LogCaptureFixture) -> None:
    rows = [{"a": 1, "b": 1.5, "c": "x", "d": 2, "e": True}, {"a": -3, "b": 2, "c": None, "e": False}]
    collection = to_geojson(mesh_from_shapely(boxes((0, 0, 1, 1), (1, 0, 2, 1))))
    for feature, row in zip(collection["features"], rows, strict=True):
        feature["properties"] = row
    with caplog.at_level("INFO", "agglo"):
        mesh = from_geojson(collection)
    assert {name: tag.tolist() for name, tag in mesh.cell_tags.items()} == {"a": [1, -3], "e": [1, 0]}
    assert "b, c, d" in caplog.text


@pytest.mark.parametrize(
    ("collection", "message"),
    [
        ({"type": "Polygon"}, "expected a GeoJSON FeatureCollection, given 'Polygon'"),
        ([], "expected a GeoJSON FeatureCollection, given 'list'"),
        ({"type": "FeatureCollection"}, "expected a GeoJSON FeatureCollection"),
        ({"type": "FeatureCollection", "features": []}, "the mesh is empty"),
        ({"type": "FeatureCollection", "features": [{"geometry": None}]}, "feature 0 has no geometry"),
        ({"type": "FeatureCollection", "features": [{"geometry": {"type": "Blob"}}]}, "feature 0"),
        (
            {
                "type": "FeatureCollection",
                "features": [{"geometry": {"type": "Point", "coordinates": [0, 1]}}],
            },
            "cell 0: expected a Polygon",
        ),
    ],
)
def test_bad_collections_are_refused(collection: dict[str, object], message: str) -> None:
    with pytest.raises(MeshError, match=message):
        from_geojson(collection)


def test_foreign_hierarchies_and_values_are_refused(run: tuple[Mesh, Hierarchy]) -> None:
    with pytest.raises(MeshError, match="belongs to another mesh"):
        to_geojson(samples.squares(4), run[1])
    with pytest.raises(MeshError, match=r"property 'UF' must be \(80,\) numbers; given shape \(3,\)"):
        to_geojson(run[0], properties={"UF": [1.0, 2.0, 3.0]})


# -- networkx --------------------------------------------------------------------------------------
def assert_same_graph(first: Graph, second: Graph) -> None:
    """Bit by bit, but for the order of neighbours."""
    for name in ("centroids", "measures", "boundary", "weights", "points", "origin", "offsets"):
        np.testing.assert_array_equal(getattr(second, name), getattr(first, name), err_msg=name)
    np.testing.assert_array_equal(second.vertex_offsets, first.vertex_offsets)
    np.testing.assert_array_equal(second.vertices, first.vertices)
    assert (first.to_scipy() != second.to_scipy()).nnz == 0
    assert len(first.indices) == len(second.indices)
    assert first.data.keys() == second.data.keys()
    for name, values in first.data.items():
        np.testing.assert_array_equal(second.data[name], values, strict=True)


@pytest.mark.parametrize(
    "name", ["voronoi:n=40,seed=1", "triangles:4", "disconnected:4", "boxes:2", "ring:8"]
)
@pytest.mark.parametrize("through_json", [False, True])
def test_graphs_survive_networkx(name: str, through_json: bool) -> None:
    graph = samples.from_spec(name).graph
    n = graph.n
    data = {
        "material": np.arange(n),
        "flag": np.arange(n) % 2 == 0,
        "small": np.arange(n, dtype=np.int16),
        "flow": np.random.default_rng(0).random((n, 2)),
    }
    graph = replace(graph, data=data, weights=graph.weights * 2)
    network = graph_to_networkx(graph)
    if through_json:
        network = nx.node_link_graph(json.loads(json.dumps(nx.node_link_data(network))))
    back = graph_from_networkx(network)
    assert_same_graph(graph, back)
    np.testing.assert_array_equal(back.diameters(), graph.diameters())


def test_blocks_survive_networkx() -> None:
    graph = samples.squares(4).graph
    level = graph.split(np.arange(16) // 4 % 2)[0]
    assert level.n_blocks == 2
    assert_same_graph(level, graph_from_networkx(graph_to_networkx(level)))


def test_a_graph_that_went_through_networkx_is_cut_alike() -> None:
    graph = samples.voronoi(200, seed=4).graph
    first, second = (
        agglomerate(each, bisector="kmeans", h_star=0.3)
        for each in (graph, graph_from_networkx(graph_to_networkx(graph)))
    )
    np.testing.assert_array_equal(first.levels[0], second.levels[0])


def test_weights_stay_the_measures() -> None:
    back = graph_from_networkx(graph_to_networkx(samples.squares(3).graph))
    assert back.weights is back.measures


def test_networkx_and_agglo_agree_on_what_a_component_is() -> None:
    graph = samples.disconnected(4).graph
    components = list(nx.connected_components(graph_to_networkx(graph)))
    assert len(components) == graph.components().max() + 1
    assert all(len(np.unique(graph.components()[list(nodes)])) == 1 for nodes in components)


def test_a_subgraph_is_one_block_with_true_diameter() -> None:
    graph = samples.squares(4).graph
    right = np.flatnonzero(graph.centroids[:, 0] > 0).tolist()
    part = graph_from_networkx(graph_to_networkx(graph).subgraph(right))
    assert part.offsets.tolist() == [0, 8]
    np.testing.assert_allclose(part.diameters(), np.hypot(0.5, 1))


def test_any_network_with_positions_will_do() -> None:
    network = nx.grid_2d_graph(4, 3)  # nodes are pairs
    nx.set_node_attributes(network, {node: node for node in network}, "pos")
    nx.set_edge_attributes(network, 2.0, "width")
    graph = graph_from_networkx(network, centroid="pos", interface="width")
    assert (graph.measures == 1).all()
    assert (graph.interface == 2).all()
    np.testing.assert_array_equal(graph.centroids + graph.origin, list(network))
    assert (graph.to_scipy() != 2 * nx.to_scipy_sparse_array(network)).nnz == 0
    assert agglomerate(graph, bisector="kmeans", n_parts=2).parts == [2]


def test_parallel_edges_add_up() -> None:
    network = nx.MultiGraph([(0, 1, {"interface": 1.0}), (0, 1, {"interface": 2.0})])
    nx.set_node_attributes(network, {0: (0, 0), 1: (1, 0)}, "centroid")
    assert graph_from_networkx(network).interface.tolist() == [3, 3]


def change(network: nx.Graph, fault: str) -> nx.Graph:
    """The network with one fault."""
    if fault == "directed":
        return network.to_directed()
    if fault == "empty":
        return nx.Graph()
    if fault == "no centroids":
        return nx.path_graph(3)
    if fault == "loop":
        network.add_edge(1, 1, interface=1.0)
    elif fault == "lacking":
        del network.nodes[2]["measure"]
    elif fault == "edge lacking":
        del network.edges[0, 1]["interface"]
    elif fault == "text":
        network.nodes[0]["measure"] = "big"
    elif fault == "negative":
        network.nodes[0]["measure"] = -1.0
    elif fault == "vertices":
        network.nodes[3]["vertices"] = [0, 99]
    return network


@pytest.mark.parametrize(
    ("fault", "message"),
    [
        ("directed", "expected an undirected graph"),
        ("empty", "no nodes"),
        ("no centroids", "every node needs the attribute 'centroid'"),
        ("loop", "node 1 has an edge to itself"),
        ("lacking", "node 2 has no attribute 'measure'"),
        ("edge lacking", "the edge between nodes 0 and 1 has no attribute 'interface'"),
        ("text", "node attribute 'measure' must be numbers"),
        ("negative", r"measures\[0\] is -1\.0"),
        ("vertices", "but there are 9 points"),
    ],
)
def test_bad_networks_are_refused(fault: str, message: str) -> None:
    with pytest.raises(MeshError, match=message):
        graph_from_networkx(change(graph_to_networkx(samples.squares(2).graph), fault))


def test_data_may_not_hide_an_attribute() -> None:
    graph = replace(samples.squares(2).graph, data={"measure": np.zeros(4)})
    with pytest.raises(MeshError, match="data 'measure' has the name of a node attribute"):
        graph_to_networkx(graph)
    with pytest.raises(MeshError, match="no node has the attribute 'porosity'"):
        graph_from_networkx(graph_to_networkx(samples.squares(2).graph), data=["porosity"])


# -- pyvista ---------------------------------------------------------------------------------------
def test_pyvista_grids_hold_cells_and_levels(run: tuple[Mesh, Hierarchy]) -> None:
    pytest.importorskip("pyvista", reason="pyvista is not installed")
    mesh, hierarchy = run
    grid = to_pyvista(mesh, hierarchy)
    assert grid.n_cells == mesh.n_cells
    np.testing.assert_allclose(grid.compute_cell_sizes().cell_data["Area"], mesh.cell_measures, rtol=1e-12)
    np.testing.assert_array_equal(grid.cell_data["level_1"], hierarchy.levels[1])
    np.testing.assert_array_equal(grid.cell_data["material"], mesh.cell_tags["material"])


def test_pyvista_grids_hold_polyhedra() -> None:
    pytest.importorskip("pyvista", reason="pyvista is not installed")
    mesh = samples.boxes(2)
    volumes = to_pyvista(mesh).compute_cell_sizes().cell_data["Volume"]
    np.testing.assert_allclose(volumes, mesh.cell_measures, rtol=1e-12)


def test_pyvista_that_is_missing_is_named(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setitem(sys.modules, "pyvista", None)
    with pytest.raises(OptionError, match="pip install pyvista"):
        to_pyvista(samples.squares(2))


def test_the_package_imports_none_of_the_others() -> None:
    others = ("shapely", "networkx", "pyvista")
    source = f"import sys, agglo_core.interchange; print([m for m in {others} if m in sys.modules])"
    answer = subprocess.run([sys.executable, "-c", source], capture_output=True, text=True, check=True)
    assert answer.stdout.strip() == "[]"


def test_methods_are_the_functions() -> None:
    mesh = samples.squares(3)
    back = Mesh.from_shapely(mesh.to_shapely(), cell_tags={"row": np.arange(9)}, name="back")
    assert (back.n_cells, back.name, back.cell_tags["row"].tolist()) == (9, "back", list(range(9)))
    graph = Graph.from_networkx(mesh.graph.to_networkx())
    assert np.array_equal(graph.indptr, mesh.graph.indptr)
    assert np.array_equal(graph.centroids, mesh.graph.centroids)


def test_geojson_of_a_level_names_parents(run: tuple[Mesh, Hierarchy]) -> None:
    mesh, hierarchy = run
    collection = to_geojson(mesh, hierarchy, level=0, properties={"UF": np.ones(int(hierarchy.parts[0]))})
    found = [feature["properties"] for feature in collection["features"]]
    assert [each["parent"] for each in found] == hierarchy.parents(0).tolist()
    assert [each["cells"] for each in found] == np.bincount(hierarchy.levels[0]).tolist()
    assert {each["UF"] for each in found} == {1.0}
    np.testing.assert_allclose(from_geojson(collection).cell_measures, hierarchy.mesh(0).cell_measures)
    for levels, level in ((hierarchy, len(hierarchy.levels)), (None, 0), (hierarchy, -1)):
        with pytest.raises(OptionError, match="level"):
            to_geojson(mesh, levels, level=level)
