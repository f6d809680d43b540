"""Coarse meshes as VTU: what is known of each agglomerate, the tags of the user, and the same mesh again."""

from __future__ import annotations

import json
from dataclasses import replace
from itertools import pairwise
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from command_line import Agglo
from numpy.typing import NDArray
from vtu_by_hand import arrays_of, cell_data_of

from agglo_core import Mesh, OptionError, agglomerate, quality, read, samples, write
from agglo_core.hierarchy import Hierarchy
from agglo_core.io import read_hierarchy
from agglo_core.measure import measure_levels

OURS = ["agglomerate", "parent", "cells", "measure", "diameter"]


def hierarchy_of(mesh: Mesh, *levels: Any) -> Hierarchy:
    given = [np.asarray(labels, np.int64) for labels in levels]
    targets = [{"parts": int(labels.max()) + 1} for labels in given]
    nested = all(len(np.unique(np.stack(pair), axis=1)[0]) == pair[0].max() + 1 for pair in pairwise(given))
    return Hierarchy(mesh, mesh.graph, given, targets, nested, {})


def corner_sets(mesh: Mesh) -> list[Any]:
    """Cells and corner coordinates of each face, in an order of their own."""
    cut = np.split(mesh.face_vertices, mesh.face_offsets[1:-1])
    loops = [sorted(mesh.points[vertices].tolist()) for vertices in cut]
    return sorted(zip(map(sorted, mesh.face_cells.tolist()), loops, strict=True))


def test_a_coarse_mesh_has_the_data_of_each_agglomerate(tmp_path: Path) -> None:
    mesh = samples.squares(4)
    fine = [0, 0, 1, 1, 0, 0, 1, 1, 2, 2, 2, 2, 3, 3, 3, 3]
    coarse = [0, 0, 0, 0, 0, 0, 0, 0, 1, 1, 1, 1, 1, 1, 1, 1]
    write(tmp_path / "m.vtu", mesh, hierarchy_of(mesh, fine, coarse))
    data = cell_data_of(tmp_path / "m_level0.vtu")
    assert list(data) == OURS
    assert data["agglomerate"].tolist() == [0, 1, 2, 3]
    assert data["parent"].tolist() == [0, 0, 1, 1]
    assert data["cells"].tolist() == [4, 4, 4, 4]
    assert data["measure"] == pytest.approx([1 / 4] * 4)
    assert data["diameter"] == pytest.approx([0.5**0.5] * 2 + [17**0.5 / 4] * 2)
    above = cell_data_of(tmp_path / "m_level1.vtu")
    assert above["parent"].tolist() == [-1, -1]
    assert above["cells"].tolist() == [8, 8]
    assert list(cell_data_of(tmp_path / "m.vtu")) == ["level_0", "level_1"]


def test_an_agglomerate_of_two_parents_has_none(tmp_path: Path) -> None:
    mesh = samples.squares(2)
    write(tmp_path / "m.vtu", mesh, hierarchy_of(mesh, [0, 1, 1, 2], [0, 0, 1, 1]))
    assert cell_data_of(tmp_path / "m_level0.vtu")["parent"].tolist() == [0, -1, 1]


def test_the_areas_are_right_where_vtk_has_others(tmp_path: Path) -> None:
    mesh = samples.squares(3)
    for given in ([0, 0, 0, 0, 1, 0, 0, 0, 0], [0, 1, 1, 0, 0, 1, 0, 0, 0]):  # a ring, a hook
        write(tmp_path / "m.vtu", mesh, hierarchy_of(mesh, given))
        arrays = arrays_of(tmp_path / "m_level0.vtu")
        assert arrays["measure"] == pytest.approx(np.bincount(given) / 9)
        assert areas_of_vtk(arrays)[0] > 1.1 * arrays["measure"][0]
    mesh = samples.voronoi(300)
    write(tmp_path / "v.vtu", mesh, agglomerate(mesh, h_factor=4.0, bisector="coordinate"))
    arrays = arrays_of(tmp_path / "v_level0.vtu")
    assert arrays["measure"].sum() == pytest.approx(1)
    assert areas_of_vtk(arrays).sum() > 1.05


def areas_of_vtk(arrays: dict[str, NDArray[Any]]) -> NDArray[np.float64]:
    """Areas as VTK's filter Cell Size has them: of triangles fanned out from the first vertex."""
    points, areas = arrays["Points"].reshape(-1, 3)[:, :2], []
    for places in np.split(arrays["connectivity"], arrays["offsets"][:-1]):
        sides = points[places[1:]] - points[places[0]]
        (x, y), (u, v) = sides[:-1].T, sides[1:].T
        areas.append(0.5 * np.abs(x * v - y * u).sum())
    return np.array(areas)


# -- the same mesh again -----------------------------------------------------------------------


def bands(mesh: Mesh, count: int) -> NDArray[np.int64]:
    """Labels by position: connected or not, convex or not."""
    x = mesh.cell_centroids - mesh.cell_centroids.min(axis=0)
    cuts = (x / (x.max(axis=0) + 1e-9) * count).astype(np.int64) % 3 @ 3 ** np.arange(mesh.dim)
    return np.unique(cuts, return_inverse=True)[1]


MESHES = {
    "squares": samples.squares(9),
    "triangles": samples.triangles(6),
    "voronoi": samples.voronoi(150),
    "hexagons": samples.hexagons(5),
    "boxes": samples.boxes(4),
    "tetrahedra": samples.tetrahedra(3),
}


@pytest.mark.parametrize("name", MESHES)
def test_it_is_read_as_the_same_mesh(name: str, tmp_path: Path) -> None:
    mesh = MESHES[name]
    mesh = replace(mesh, cell_tags={"kind": bands(mesh, 4) % 2, "id": np.arange(mesh.n_cells)})
    single = np.arange(mesh.n_cells)
    for count, labels in ((0, single), (4, bands(mesh, 4)), (7, bands(mesh, 7))):
        coarse = mesh.coarsen(labels)
        h = hierarchy_of(mesh, labels)
        write(tmp_path / "m.vtu", mesh, h, level_values=[level.values for level in measure_levels(mesh, h)])
        back = read(tmp_path / "m_level0.vtu")
        assert back.cell_measures == pytest.approx(coarse.cell_measures, rel=1e-12)
        assert corner_sets(back) == corner_sets(coarse)
        assert {tag: each.tolist() for tag, each in back.cell_tags.items()} == {
            tag: each.tolist() for tag, each in coarse.cell_tags.items()
        }
        assert ("id" in back.cell_tags) == (count == 0)
        assert back.repairs == {}
        found = read_hierarchy(tmp_path / "m.vtu")[1]
        assert found is not None
        assert found.levels[0].tolist() == labels.tolist()


def test_a_coarse_mesh_can_be_agglomerated_again(tmp_path: Path) -> None:
    mesh = samples.squares(6)
    write(tmp_path / "m.vtu", mesh, hierarchy_of(mesh, np.arange(36) // 2))
    coarse = read(tmp_path / "m_level0.vtu")
    write(tmp_path / "c.vtu", coarse, hierarchy_of(coarse, np.arange(18) // 3))
    assert list(cell_data_of(tmp_path / "c_level0.vtu")) == OURS
    assert read(tmp_path / "c_level0.vtu").cell_tags == {}


def test_another_program_may_save_it_again(tmp_path: Path) -> None:
    """Without our marks, the data are what those of any file are: whole numbers become tags."""
    mesh = samples.squares(4)
    write(tmp_path / "m.vtu", mesh, hierarchy_of(mesh, np.arange(16) // 4))
    content = (tmp_path / "m_level0.vtu").read_bytes()
    assert content.count(b' agglo="derived"') == len(OURS)
    (tmp_path / "saved.vtu").write_bytes(content.replace(b' agglo="derived"', b""))
    back = read(tmp_path / "saved.vtu")
    assert sorted(back.cell_tags) == ["agglomerate", "cells", "parent"]
    assert back.repairs == {"cell data that are not integers left out": 2}


# -- values of the caller ----------------------------------------------------------------------


def test_what_was_measured_is_kept_whatever_it_is(tmp_path: Path) -> None:
    mesh = samples.squares(4)
    h = hierarchy_of(mesh, np.arange(16) // 4, np.arange(16) // 8)
    odd = [np.nan, np.inf, -np.inf, -0.0]
    write(tmp_path / "m.vtu", mesh, h, level_values=[{"UF": odd, "count": [1, 2, 3, 4]}, {"<&\"'>": [0, 1]}])
    data = cell_data_of(tmp_path / "m_level0.vtu")
    assert list(data) == [*OURS, "UF", "count"]
    assert data["UF"].tobytes() == np.array(odd).tobytes()
    assert data["count"].tolist() == [1, 2, 3, 4]
    assert cell_data_of(tmp_path / "m_level1.vtu")["<&\"'>"].tolist() == [0, 1]
    assert read(tmp_path / "m_level0.vtu").repairs == {}


def test_our_names_give_way_to_tags(tmp_path: Path, caplog: pytest.LogCaptureFixture) -> None:
    tags = {name: np.repeat([7, 8], 8) for name in ("cells", "UF", "agglo_cells", "measure")}
    mesh = replace(samples.squares(4), cell_tags={**tags, "parent": np.arange(16)})
    h = hierarchy_of(mesh, np.arange(16) // 8)
    with caplog.at_level("INFO", "agglo"):
        write(tmp_path / "m.vtu", mesh, h, level_values=[{"UF": [0.5, 0.25], "agglo_loops": [1, 1]}])
    assert "'cells' are written as 'agglo_agglo_cells'" in caplog.text
    data = cell_data_of(tmp_path / "m_level0.vtu")
    twice = {"agglo_agglo_cells", "agglo_agglo_loops"}
    assert set(data) == {
        *tags,
        "agglomerate",
        "agglo_parent",
        "agglo_measure",
        "diameter",
        "agglo_UF",
        *twice,
    }
    assert data["cells"].tolist() == data["UF"].tolist() == [7, 8]
    assert data["agglo_agglo_cells"].tolist() == [8, 8]
    assert data["agglo_UF"].tolist() == [0.5, 0.25]
    assert {name: each.tolist() for name, each in read(tmp_path / "m_level0.vtu").cell_tags.items()} == {
        name: [7, 8] for name in tags
    }


@pytest.mark.parametrize(
    ("values", "message"),
    [
        ([], "0 mappings given for 1 levels"),
        ([{}, {}], "2 mappings given for 1 levels"),
        ([{"UF": [1.0]}], r"level_values\[0\]\['UF'\]: expected 4 numbers, given float64 of shape \(1,\)"),
        ([{"UF": ["a"] * 4}], r"\['UF'\]: expected 4 numbers, given <U1 of shape"),
        ([{"UF": [1j] * 4}], r"\['UF'\]: expected 4 numbers, given complex128"),
        ([{"\x01": [1.0] * 4}], r"level_values\[0\]: the name '\\x01' must be printable"),
        ([{"": [1.0] * 4}], "the name '' must be printable"),
    ],
)
@pytest.mark.parametrize("suffix", [".vtu", ".npz"])
def test_values_that_do_not_fit_are_refused(values: Any, message: str, suffix: str, tmp_path: Path) -> None:
    mesh = samples.squares(4)
    with pytest.raises(OptionError, match=message):
        write(tmp_path / f"m{suffix}", mesh, hierarchy_of(mesh, np.arange(16) // 4), level_values=values)
    assert list(tmp_path.iterdir()) == []


# -- the commands ------------------------------------------------------------------------------


def test_run_writes_what_it_measured(agglo: Agglo, tmp_path: Path) -> None:
    arguments = [
        "--bisector",
        "coordinate",
        "--parts",
        "12,4",
        "--metrics",
        "UF,CR",
        "-o",
        "out.vtu",
        "--json",
    ]
    code, out, err = agglo("run", "voronoi:n=60", *arguments)
    assert code == 0, err
    mesh, found = read_hierarchy(tmp_path / "out.vtu")
    assert found is not None
    for place, labels in enumerate(found.levels):
        data = cell_data_of(tmp_path / f"out_level{place}.vtu")
        assert list(data) == [*OURS, "UF", "CR", "components"]
        for name, values in quality(mesh, labels, ["UF", "CR"]).items():
            assert data[name] == pytest.approx(values)
            assert data[name].mean() == pytest.approx(json.loads(out)["runs"][0]["levels"][place][name])
