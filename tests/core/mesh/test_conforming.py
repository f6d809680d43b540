"""Non-conforming meshes: outer faces that lie on one another are found and joined, told or refused."""

from __future__ import annotations

import json
import logging
from itertools import pairwise
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import shapely
from command_line import Agglo
from hypothesis import given, settings, strategies as st

from agglo_core import Mesh, MeshError, OptionError, agglomerate, read, read_hierarchy, samples, write
from agglo_core.arrays import frozen_int, trusted
from agglo_core.mesh.elements import polyhedra_from_elements

Box = tuple[float, float, float, float]


def grid(nx: int, ny: int, box: Box) -> tuple[Any, Any]:
    """Points and squares of a block."""
    x, y = np.meshgrid(np.linspace(box[0], box[2], nx + 1), np.linspace(box[1], box[3], ny + 1))
    low = (np.arange(ny)[:, None] * (nx + 1) + np.arange(nx)).ravel()
    return np.column_stack((x.ravel(), y.ravel())), low[:, None] + [0, 1, nx + 2, nx + 1]


def bricks(n: int, x: float, y: float = 0.0, size: float = 1.0) -> tuple[Any, Any]:
    """Points and hexahedra of a cube of n³ of them."""
    axes = (np.linspace(at, at + size, n + 1) for at in (x, y, 0.0))
    points = np.stack(np.meshgrid(*axes, indexing="ij"), axis=-1).reshape(-1, 3)
    i, j, k = (each.ravel() for each in np.meshgrid(*[np.arange(n)] * 3, indexing="ij"))
    ring = np.array([0, (n + 1) ** 2, (n + 1) * (n + 2), n + 1])
    return points, ((i * (n + 1) + j) * (n + 1) + k)[:, None] + np.concatenate((ring, ring + 1))


def together(*blocks: tuple[Any, Any]) -> tuple[Any, Any]:
    """Blocks with points of their own as one list of points and cells."""
    starts = np.cumsum([0, *(len(points) for points, _ in blocks)])
    cells = [cells + start for (_, cells), start in zip(blocks, starts, strict=False)]
    return np.concatenate([points for points, _ in blocks]), np.concatenate(cells)


def solids(*blocks: tuple[Any, Any], **options: Any) -> Mesh:
    points, cells = together(*blocks)
    return Mesh.from_polyhedra(points, polyhedra_from_elements({"hexahedron": cells}), **options)


def pairs(mesh: Mesh) -> int:
    """How many pairs of neighbours the mesh has."""
    return len(mesh.graph.indices) // 2


TWO_BLOCKS = together(grid(2, 4, (0, 0, 0.5, 1)), grid(4, 8, (0.5, 0, 1, 1)))
HANGING = ([[0, 0], [1, 0], [1, 2], [0, 2], [2, 0], [2, 1], [1, 1], [2, 2]],
           [[0, 1, 2, 3], [1, 4, 5, 6], [6, 5, 7, 2]])  # fmt: skip
SLIT = ([[0, 0], [1, 0], [0, 1], [1, 0], [1, 1], [0, 1]], [[0, 1, 2], [3, 4, 5]])


# -- the plane -----------------------------------------------------------------------------------------
def test_two_blocks_of_squares_are_one_domain() -> None:
    mesh = Mesh.from_polygons(*TWO_BLOCKS)
    assert dict(mesh.repairs) == {"hanging vertices inserted": 4, "points of outer faces merged": 5}
    assert pairs(mesh) == (4 + 2 * 3) + (3 * 8 + 4 * 7) + 8
    assert mesh.graph.boundary.sum() == pytest.approx(4, rel=1e-15)
    assert mesh.cell_measures.sum() == pytest.approx(1, rel=1e-15)


@pytest.mark.parametrize("joined", [False, True])
def test_a_solution_does_not_see_the_interface(joined: bool, tmp_path: Path, agglo: Agglo) -> None:
    blocks = together(grid(8, 16, (0, 0, 0.5, 1)), grid(16, 32, (0.5, 0, 1, 1)))
    file = tmp_path / ("joined.npz" if joined else "apart.vtu")
    write(file, Mesh.from_polygons(*blocks, allow_gaps=not joined))
    done = agglo("solve", str(file), "--degree", "2", "--h-factor", "4", "--no-cg", "--json")
    # f = 8 and u = 0 around the unit square: 64 · 0.035144; if u = 0 on the interface too: 0.859
    assert json.loads(done.out)["energy"] == pytest.approx(64 * 0.0351442540, rel=1e-3)


def test_hanging_vertices_are_inserted_and_reported(caplog: pytest.LogCaptureFixture) -> None:
    with caplog.at_level(logging.INFO, logger="agglo"):
        mesh = Mesh.from_polygons(*HANGING)
    assert dict(mesh.repairs) == {"hanging vertices inserted": 1}
    assert "hanging vertices inserted: 1" in caplog.text
    assert pairs(mesh) == 3
    assert np.diff(mesh.boundary_loops.loop_offsets).tolist() == [5, 4, 4]
    apart = Mesh.from_polygons(*HANGING, allow_gaps=True)
    assert (pairs(apart), dict(apart.repairs)) == (1, {})


def test_a_mesh_made_otherwise_is_mended_and_keeps_cells_and_tags() -> None:
    apart = Mesh.from_polygons(*HANGING, allow_gaps=True, cell_tags={"rock": [3, 4, 5]})
    long = int(np.flatnonzero(np.isclose(apart.face_measures, 2) & (apart.face_normals[:, 0] > 0.9))[0])
    side, line = np.arange(apart.n_faces), np.full(apart.n_faces, -1)
    side[long], line[long] = 77, 6
    mesh = Mesh(
        apart.points, apart.face_offsets, apart.face_vertices, apart.face_cells,
        apart.cell_tags, {"side": side, "line": line},
    ).conforming()  # fmt: skip
    assert mesh.cell_tags["rock"].tolist() == [3, 4, 5]
    np.testing.assert_array_equal(mesh.cell_measures, apart.cell_measures)
    halves = np.flatnonzero((mesh.face_cells[:, 0] == 0) & (mesh.face_cells[:, 1] > 0))
    assert len(halves) == 2
    assert mesh.face_tags["line"][halves].tolist() == [6, 6]  # the other side has −1
    assert mesh.face_tags["side"][halves].tolist() == [77, 77]  # the first face of the two
    assert (mesh.face_tags["line"] == 6).sum() == 2


@pytest.mark.parametrize("mesh", [samples.voronoi(60), samples.disconnected(3), samples.boxes(2)], ids=repr)
def test_a_conforming_mesh_is_left_as_it_is(mesh: Mesh) -> None:
    assert mesh.conforming() is mesh
    coarse = mesh.coarsen(np.arange(mesh.n_cells) // 3)
    assert coarse.conforming() is coarse


def test_a_mesh_without_boundary_has_nothing_to_join() -> None:
    ends, sides = frozen_int([0, 1, 1, 2, 2, 3, 3, 0]), frozen_int([[0, 1], [1, 0], [0, 1], [1, 0]])
    torus = trusted(Mesh, np.eye(4, 2), frozen_int(np.arange(0, 9, 2)), ends, sides)
    assert torus.conforming() is torus


def test_the_same_points_twice() -> None:
    assert pairs(Mesh.from_polygons(*SLIT)) == 1
    assert Mesh.from_polygons(*SLIT).repairs == {"points of outer faces merged": 2}
    assert Mesh.from_polygons(*SLIT, merge_points=True).repairs == {"equal points merged": 2}


def test_points_kept_apart_on_purpose_are_reported(caplog: pytest.LogCaptureFixture) -> None:
    mesh = Mesh.from_polygons(*SLIT, merge_points=False)
    assert (mesh.n_points, pairs(mesh)) == (6, 0)
    assert mesh.repairs == {"outer faces on one another left apart": 1}
    assert "1 pairs of outer faces, such as of cells 0 and 1, coincide but were not joined" in caplog.text
    caplog.clear()
    assert Mesh.from_polygons(*SLIT, allow_gaps=True).repairs == {}
    assert not caplog.text


def test_a_crack_is_closed_unless_it_is_meant() -> None:
    points, cells = grid(4, 4, (0, 0, 4, 4))
    double = np.concatenate((points, points[[11]]))  # the middle of three points of a crack along y = 2
    upper = np.where((cells == 11) & (np.arange(16)[:, None] >= 8), 25, cells)
    crack = Mesh.from_polygons(double, upper, allow_gaps=True)
    assert pairs(crack) == 24 - 2
    closed = Mesh.from_polygons(double, upper)
    assert (pairs(closed), closed.repairs) == (24, {"points of outer faces merged": 1})


def test_overlapping_cells_are_warned_about(caplog: pytest.LogCaptureFixture) -> None:
    mesh = Mesh.from_polygons(
        *together(grid(1, 1, (0, 0, 1, 1)), grid(1, 1, (1, 0, 2, 1)), grid(1, 1, (1, 0, 3, 2)))
    )
    assert mesh.repairs == {"outer faces on one another left apart": 2}
    assert "2 pairs of outer faces" in caplog.text
    assert pairs(mesh) == 0


@pytest.mark.parametrize("gap", [1e-4, -1e-4])
def test_faces_that_almost_touch_are_warned_about(gap: float, caplog: pytest.LogCaptureFixture) -> None:
    blocks = together(grid(1, 2, (0, 0, 1, 2)), grid(1, 1, (1 + gap, 0, 3, 2)))
    mesh = Mesh.from_polygons(*blocks)
    assert pairs(mesh) == 1
    assert "2 pairs of outer faces, such as of cells 0 and 2, coincide only approximately" in caplog.text
    assert pairs(mesh.conforming(tolerance=1e-3)) == 3
    assert mesh.conforming(tolerance=1e-3).cell_measures.sum() == pytest.approx(6, abs=4e-4)


def test_a_vertex_on_an_arc_beside_a_chord_is_warned_about(caplog: pytest.LogCaptureFixture) -> None:
    """As where a mesh with round sides was refined in places: the vertex is .8 % of an edge off the chord."""
    points = [[0, 0], [1, 0], [1, 2], [0, 2], [1.008, 1], [2, 0], [2, 1], [2, 2]]
    mesh = Mesh.from_polygons(points, [[0, 1, 2, 3], [1, 5, 6, 4], [4, 6, 7, 2]])
    assert pairs(mesh) == 1
    assert "2 pairs of outer faces, such as of cells 0 and 1, coincide only approximately" in caplog.text
    assert pairs(mesh.conforming(tolerance=1e-2)) == 3


def test_single_precision_is_close_enough() -> None:
    points, cells = together(grid(1, 50, (0, 0, 0.01, 0.5)), grid(2, 100, (0.01, 0, 0.02, 0.5)))
    turned = points @ [[0.8, 0.6], [-0.6, 0.8]] + 1
    mesh = Mesh.from_polygons(turned.astype(np.float32), cells)
    assert pairs(mesh) == 49 + (100 + 2 * 99) + 100
    assert mesh.graph.boundary.sum() == pytest.approx(1.04, rel=1e-4)


def test_an_edge_shorter_than_the_tolerance_may_vanish(caplog: pytest.LogCaptureFixture) -> None:
    points = [[0, 0], [1, 0], [1, 1], [0, 1], [2, 0], [2, 1], [1, 1e-8]]
    mesh = Mesh.from_polygons(points, [[0, 1, 2, 3], [1, 4, 5, 2, 6]])
    assert (mesh.n_faces, pairs(mesh), mesh.n_points) == (7, 1, 6)
    assert mesh.cell_measures.tolist() == [1, 1]
    assert not caplog.text


@pytest.mark.parametrize("thickness", [1e-3, 1e-6, 1e-9])
def test_thin_cells_do_not_touch_themselves(thickness: float, caplog: pytest.LogCaptureFixture) -> None:
    points, cells = grid(6, 1, (0, 0, 6, thickness))
    assert Mesh.from_polygons(points, cells).repairs == {}
    halves = np.concatenate((cells[:, :3], cells[:, [0, 2, 3]]))
    assert Mesh.from_polygons(points, halves).repairs == {}
    layers = together((points, cells), grid(3, 2, (0, thickness, 6, 3 * thickness)))
    assert Mesh.from_polygons(*layers).repairs["hanging vertices inserted"] == 3
    assert not caplog.text


def test_the_tolerance_is_a_small_number() -> None:
    with pytest.raises(OptionError, match=r"tolerance must lie between 0 and 0\.01, given 0\.5"):
        samples.squares(2).conforming(tolerance=0.5)


# -- random unions of blocks, with shapely as the judge -------------------------------------------------
@st.composite
def unions(draw: st.DrawFn) -> tuple[list[tuple[Any, Any]], float]:
    """Rows of blocks on a lattice, cut anywhere and at any resolution, some left out; and an angle."""
    blocks = []
    for low, high in pairwise([0, *sorted(draw(st.sets(st.integers(1, 5), max_size=3))), 6]):
        for left, right in pairwise([0, *sorted(draw(st.sets(st.integers(1, 5), max_size=3))), 6]):
            if draw(st.integers(0, 5)):
                nx, ny = draw(st.integers(1, 4)), draw(st.integers(1, 4))
                blocks.append(grid(nx, ny, (12 * left, 12 * low, 12 * right, 12 * high)))
    return blocks or [grid(2, 3, (0, 0, 12, 12))], draw(st.sampled_from([0.0, 0.3, 1.1]))


@given(unions(), st.sampled_from([(0.0, 1.0), (1e5, 1.0), (-3.0, 1e-30)]))
@settings(max_examples=30, deadline=None)
def test_any_union_of_blocks(union: tuple[list[tuple[Any, Any]], float], move: tuple[float, float]) -> None:
    (points, cells), (shift, scale) = together(*union[0]), move
    polygons = shapely.polygons(points[cells])  # on a lattice: exact
    first, second = shapely.STRtree(polygons).query(polygons, predicate="intersects")
    length = shapely.length(shapely.intersection(polygons[first], polygons[second]))
    expected = {
        (i, j): x
        for i, j, x in zip(first.tolist(), second.tolist(), length.tolist(), strict=True)
        if i < j and x
    }
    c, s = np.cos(union[1]), np.sin(union[1])
    mesh = Mesh.from_polygons(scale * (points @ [[c, s], [-s, c]] + shift), cells)
    graph = mesh.graph
    rows = np.repeat(np.arange(mesh.n_cells), np.diff(graph.indptr))
    found = {
        (i, j): x / scale
        for i, j, x in zip(rows.tolist(), graph.indices.tolist(), graph.interface.tolist(), strict=True)
        if i < j
    }
    assert found == pytest.approx(expected, rel=1e-7)
    np.testing.assert_allclose(mesh.cell_measures / scale**2, shapely.area(polygons), rtol=1e-7)
    assert graph.boundary.sum() / scale == pytest.approx(shapely.union_all(polygons).length, rel=1e-7)
    assert "outer faces on one another left apart" not in mesh.repairs
    assert mesh.conforming() is mesh


# -- space ---------------------------------------------------------------------------------------------
def test_a_finer_box_beside_a_coarse_one() -> None:
    mesh = solids(bricks(2, 0), bricks(4, 1))
    assert mesh.repairs == {"faces split like those of neighbours": 4, "points of outer faces merged": 9}
    assert pairs(mesh) == 3 * 4 + 3 * 3 * 16 + 16
    assert mesh.graph.boundary.sum() == pytest.approx(10)
    assert mesh.cell_measures.sum() == pytest.approx(2)
    sides = mesh.face_cells >= 0
    assert sides.all(axis=1).sum() == pairs(mesh)
    again = solids(bricks(4, 1), bricks(2, 0))  # whichever comes first, normals point out of the owner
    for each in (mesh, again):
        between = each.cell_centroids[each.face_cells[:, 1]] - each.cell_centroids[each.face_cells[:, 0]]
        assert ((between * each.face_normals).sum(axis=1)[(each.face_cells >= 0).all(axis=1)] > 0).all()


def test_equal_faces_with_points_of_their_own() -> None:
    mesh = solids(bricks(2, 0), bricks(2, 1))
    assert mesh.repairs == {"points of outer faces merged": 9}
    assert pairs(mesh) == 28
    apart = solids(bricks(2, 0), bricks(2, 1), merge_points=False)
    assert (pairs(apart), apart.repairs) == (24, {"outer faces on one another left apart": 4})


@pytest.mark.parametrize("other", [bricks(3, 1), bricks(2, 1, 0.25), bricks(1, 1, 0.25, 0.5)])
def test_solids_whose_faces_overlap_in_part_are_refused(other: tuple[Any, Any]) -> None:
    with pytest.raises(
        MeshError, match=r"such as of cells \d and \d+, coincide only partially.*allow_gaps=True"
    ):
        solids(bricks(2, 0), other)
    assert pairs(solids(bricks(2, 0), other, allow_gaps=True)) == 12 + pairs(solids(other))


@pytest.mark.parametrize("thickness", [1.0, 1e-3, 1e-9])
def test_thin_plates_do_not_touch_themselves(thickness: float, caplog: pytest.LogCaptureFixture) -> None:
    points, cells = bricks(3, 0)
    plate = Mesh.from_polyhedra(points * [1, 1, thickness], polyhedra_from_elements({"hexahedron": cells}))
    assert plate.repairs == {}
    assert not caplog.text


def test_solids_that_meet_in_an_edge_or_a_point_are_no_neighbours() -> None:
    assert solids(bricks(1, 0), bricks(1, 1, 1)).repairs == {}
    assert pairs(solids(bricks(2, 0), bricks(3, 1, 1))) == 12 + 54


# -- files ---------------------------------------------------------------------------------------------
@pytest.mark.parametrize("suffix", ["vtu", "vtk", "npz"])
def test_a_file_of_two_blocks(suffix: str, tmp_path: Path) -> None:
    path = tmp_path / f"two.{suffix}"
    points, cells = TWO_BLOCKS
    if suffix == "npz":
        ends = np.arange(0, cells.size + 1, 4)
        np.savez(path, points=points, cell_offsets=ends, cell_vertices=cells.ravel())
    else:
        write(path, Mesh.from_polygons(points, cells, allow_gaps=True))
    mesh = read(path)
    assert mesh.repairs == {"equal points merged": 5, "hanging vertices inserted": 4}
    assert pairs(mesh) == 70
    apart = read(path, merge_points=False, allow_gaps=True)
    assert (pairs(apart), apart.n_points) == (62, len(points))


def test_lines_in_a_file_tag_both_parts_of_a_split_face(tmp_path: Path) -> None:
    path = tmp_path / "lines.msh"
    path.write_text(
        "$MeshFormat\n2.2 0 8\n$EndMeshFormat\n$Nodes\n8\n"
        + "".join(f"{i + 1} {x} {y} 0\n" for i, (x, y) in enumerate(HANGING[0]))
        + "$EndNodes\n$Elements\n4\n1 1 2 9 1 2 3\n"
        + "".join(f"{i + 2} 3 2 5 1 {' '.join(str(v + 1) for v in c)}\n" for i, c in enumerate(HANGING[1]))
        + "$EndElements\n"
    )
    mesh = read(path)
    tagged = np.flatnonzero(mesh.face_tags["gmsh:physical"] == 9)
    assert mesh.repairs["hanging vertices inserted"] == 1
    assert sorted(map(tuple, np.sort(mesh.face_cells[tagged], axis=1).tolist())) == [(0, 1), (0, 2)]


def test_a_native_file_is_reported_but_never_changed(
    tmp_path: Path, caplog: pytest.LogCaptureFixture
) -> None:
    mesh = Mesh.from_polygons(*HANGING, allow_gaps=True)
    hierarchy = agglomerate(mesh, n_parts=2)
    write(tmp_path / "old.npz", mesh, hierarchy)
    back, stored = read_hierarchy(tmp_path / "old.npz")
    assert back.fingerprint == mesh.fingerprint
    assert stored is not None
    assert "2 pairs of outer faces, such as of cells 0 and 1, coincide" in caplog.text
    assert "mesh.conforming() joins them" in caplog.text
    assert back.conforming().coarsen(stored.levels[0]).n_cells == 2
    caplog.clear()
    read(tmp_path / "old.npz", allow_gaps=True)
    read_hierarchy(tmp_path / "old.npz", allow_gaps=True)
    assert not caplog.text


# -- units of length -----------------------------------------------------------------------------------
@pytest.mark.parametrize("exponent", [-49, -30, 30, 49])
def test_repairs_do_not_depend_on_the_unit_of_length(exponent: int) -> None:
    scale = 2.0 ** round(exponent / np.log10(2))  # exact
    flat, solid = TWO_BLOCKS[1], polyhedra_from_elements({"hexahedron": bricks(2, 0)[1]})
    for one, mesh in (
        (Mesh.from_polygons(TWO_BLOCKS[0], flat), Mesh.from_polygons(scale * TWO_BLOCKS[0], flat)),
        (Mesh.from_polyhedra(bricks(2, 0)[0], solid), Mesh.from_polyhedra(scale * bricks(2, 0)[0], solid)),
    ):
        assert mesh.face_cells.tolist() == one.face_cells.tolist()
        np.testing.assert_array_equal(mesh.cell_measures, scale**one.dim * one.cell_measures)
        np.testing.assert_array_equal(mesh.cell_centroids, scale * one.cell_centroids)
        np.testing.assert_allclose(mesh.cell_diameters, scale * one.cell_diameters, rtol=1e-14)


@pytest.mark.parametrize(
    ("bisector", "scale"), [("kmeans", 1e-30), ("kmeans", 1e30), ("metis", 1e-49), ("metis", 1e49)]
)
def test_agglomerates_do_not_depend_on_the_unit_of_length(bisector: str, scale: float) -> None:
    one = samples.voronoi(50, seed=1)
    loops = one.boundary_loops
    mesh = Mesh.from_polygons(scale * one.points, (loops.loop_offsets, loops.vertices))
    parts = [agglomerate(each, bisector=bisector, n_parts=6).levels[0].tolist() for each in (one, mesh)]
    assert parts[0] == parts[1]


@pytest.mark.parametrize("scale", [1e-160, 1e-80, 1e-74, 1e74, 1e80, 1e155])
def test_lengths_whose_powers_are_no_numbers_are_refused(scale: float) -> None:
    points, cells = bricks(2, 0)
    solid = polyhedra_from_elements({"hexahedron": cells})
    for make in (
        lambda: Mesh.from_polygons(scale * TWO_BLOCKS[0], TWO_BLOCKS[1]),
        lambda: Mesh.from_polyhedra(scale * points, solid),
        lambda: Mesh.from_shapely([shapely.box(0, 0, scale, scale)]),
    ):
        with pytest.raises(MeshError, match=r"across; .* from 1e-50 to 1e\+50: choose another unit"):
            make()
