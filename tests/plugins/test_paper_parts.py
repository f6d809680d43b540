"""Verdicts, tables, statistics, the store and the meshes of ``agglo paper``, on cases done by hand."""

from __future__ import annotations

import json
import logging
from dataclasses import replace
from math import sqrt
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from agglo_core import OptionError, PluginError, samples
from agglo_core.registry import Registry
from agglo_paper import figures
from agglo_paper.statistics import Paired
from agglo_paper.tables.multigrid import TABLES
from agglo_paper.tables.published import Band, band, judge, judge_row, published_values
from agglo_paper.tables.record import Cell, Page, Row, Table
from agglo_paper.tables.shapes import ratio
from agglo_paper.work import plan
from agglo_paper.work.grids import FAMILIES, GRIDS, load, targets
from agglo_paper.work.measures import SETTINGS, plain
from agglo_paper.work.store import Store, Unit, versions
from agglo_paper.work.strategies import columns

SHARE, PART = Band(0.03, False), Band(0.35, True)


@pytest.mark.parametrize(
    ("cell", "width", "verdict"),
    [
        (Cell(0.70711, 0.7071), SHARE, "reproduced"),
        (Cell(0.7169, 0.7071), SHARE, "within band"),
        (Cell(0.80, 0.7071), SHARE, "not reproduced"),
        (Cell(0.80, 0.7071, 0.69, 0.85), SHARE, "within band"),
        (Cell(9.0, 9.0), PART, "reproduced"),
        (Cell(9.0, 9.0, flag="*"), PART, "within band"),
        (Cell(135.0, 100.0), PART, "within band"),
        (Cell(136.0, 100.0), PART, "not reproduced"),
        (Cell(None, 100.0), PART, "not reproduced"),
        (Cell(3.0), PART, ""),
    ],
)
def test_verdicts(cell: Cell, width: Band, verdict: str) -> None:
    assert judge(cell, width) == verdict


def test_a_row_is_judged_by_kmeans_and_the_better_network() -> None:
    near, far, same = Cell(0.52, 0.5), Cell(0.9, 0.5), Cell(0.5, 0.5)
    cells = {"METIS": far, "k-means": same, "GNN": far, "gnn": same}
    row = judge_row("uf", "squares", cells, SHARE)
    assert row.verdict == "reproduced (METIS not reproduced, GNN not reproduced)"
    assert any("perfect squares" in reason for reason in row.why)
    assert judge_row("uf", "random", {**cells, "k-means": near}, SHARE).verdict.startswith("within band (")
    assert judge_row("uf", "random", {**cells, "k-means": far}, SHARE).verdict.startswith("not reproduced (")
    assert judge_row("mg-m1", "random", {"CG": near}, SHARE).verdict == "within band"
    others = {"CG": Band(0.01, True)}
    both = judge_row("mg-m1", "random", {"k-means": same, "CG": Cell(110.0, 100.0)}, PART, others)
    assert both.verdict == "reproduced (CG not reproduced)"
    assert judge_row("uf", "random", {"k-means": same}, SHARE).why == []


def test_every_printed_number_has_a_place_and_ratios_fit() -> None:
    numbers = published_values()
    for grid in GRIDS:
        for table in ("uf", "cr"):
            for column, value in numbers[f"{table}_relative"][grid].items():
                quotient = numbers[table][grid][column] / numbers[table][grid]["METIS"]
                assert value == pytest.approx(quotient, rel=6e-4)
        counts = numbers["multigrid"][grid]
        assert {len(counts[column]) for column in ("METIS", "k-means", "GNN")} == {len(SETTINGS)}
        assert len(counts["CG"]) == 3
    shown = {index for _, _, chosen in TABLES.values() for index in chosen}
    assert shown == set(range(len(SETTINGS)))
    assert band("uf") == Band(0.03, False)
    assert band("counts").relative


def test_cells_rows_and_tables_in_markdown_and_as_data() -> None:
    assert Cell(0.5, 0.25, 0.4, 0.6).text(2) == "0.25 / 0.50 (0.40–0.60)"
    assert Cell(17.0, None, 17.0, 17.0).text(0) == "17"
    assert Cell(246.5).text(0) == "246.5"
    assert Cell(None, 3.0).text(0) == "3 / –"
    rows = [
        Row("a", {"x": Cell(1.0, 1.0), "y": "words"}, "reproduced", ["r1", "r2"]),
        Row("b", {"x": Cell(float("nan"))}, "", ["r2"]),
    ]
    made = Table("t", "Title", rows, 0, notes=["note"]).markdown()
    assert "| grid | x | y | verdict |" in made
    assert "| a | 1 / 1 | words | reproduced [1] [2] |" in made
    assert "| b | – | – | – [2] |" in made
    assert "- [2] r2." in made
    assert "*note.*" in made
    page = Page("p", "P", "Intro.", [Table("t", "Title", rows)], {"f.svg": "F"}, ["c on m: why"])
    assert page.markdown().startswith("# P\n\nIntro.\n")
    assert "![F](f.svg)" in page.markdown()
    assert "*c on m: why.*" in page.markdown()
    data = page.data()
    assert data["tables"][0]["rows"][0]["cells"] == {"x": {"ours": 1.0, "paper": 1.0}, "y": "words"}
    json.dumps(data, allow_nan=False)


def test_quotients_carry_the_range() -> None:
    found = ratio(Cell(0.8, None, 0.7, 0.9), Cell(0.4, None, 0.35, 0.5), 2.1)
    assert (found.ours, found.low, found.high) == pytest.approx((2.0, 1.4, 0.9 / 0.35))
    assert ratio(Cell(None), Cell(0.4), 2.1) == Cell(None, 2.1)


def test_paired_differences_and_sign_test() -> None:
    first = np.array([3.0, 4.0, 5.0, 6.0, 7.0, np.nan, 1.0])
    second = np.array([1.0, 2.0, 3.0, 4.0, 8.0, 1.0, 1.0])
    found = Paired(first, second, more=True)
    assert (found.n, found.wins, found.losses) == (6, 4, 1)
    assert found.mean == pytest.approx(7 / 6)
    assert found.p == pytest.approx(2 * (5 + 1) / 32)
    assert found.outcome == "no difference"
    fewer = Paired(np.zeros(8), np.ones(8), more=False)
    assert (fewer.outcome, fewer.p) == ("better", pytest.approx(2 / 256))
    assert fewer.text(1) == "-1.0 ± 0.0; 8:0; p = 0.008; better"
    assert Paired(np.zeros(8), np.ones(8), more=True).outcome == "worse"
    assert Paired(np.ones(3), np.ones(3), more=True).p == 1.0
    assert Paired(np.array([np.nan]), np.ones(1), more=True).text(1) == "–"
    lost = Paired(np.array([np.inf, 3.0, np.inf]), np.array([5.0, np.inf, np.inf]), more=False)
    assert (lost.n, lost.wins, lost.losses, lost.mean) == (3, 1, 1, 0.0)  # who does not converge loses


def doubled(number: int) -> dict[str, Any]:
    """Work that counts its calls in the log."""
    logging.getLogger("agglo.test").info("called")
    if number < 0:
        raise OptionError("negative")
    if number == 13:
        try:
            raise KeyboardInterrupt
        except KeyboardInterrupt as stop:
            raise PluginError("some component raised KeyboardInterrupt") from stop
    return {"twice": 2 * number}


def test_the_store_keeps_results_and_not_failures(tmp_path: Path, caplog: pytest.LogCaptureFixture) -> None:
    caplog.set_level(logging.INFO, "agglo.test")
    store, known = Store(tmp_path / "cache"), []
    units = [Unit(doubled, {"number": n}) for n in (1, 2, -1, 1)]
    for _ in range(2):
        found = store.results(units, lambda unit, kept: known.append(kept))
    assert [found[unit.key] for unit in units] == [
        {"twice": 2},
        {"twice": 4},
        {"error": "negative"},
        {"twice": 2},
    ]
    assert known == [False, False, False, True, True, False]
    assert len(caplog.records) == 4
    assert {file.suffix for file in (tmp_path / "cache").iterdir()} == {".json", ""}
    assert (tmp_path / "cache" / ".gitignore").read_text() == "*\n"
    for file in (tmp_path / "cache").glob("*.json"):
        file.write_text("{}")
    store.results(units[:2], lambda unit, kept: known.append(kept))
    assert known[-2:] == [False, False]
    with pytest.raises(PluginError):
        store.results([Unit(doubled, {"number": 13})], lambda unit, kept: None)


def test_results_of_other_code_do_not_count(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    kept: list[bool] = []
    unit = Unit(doubled, {"number": 5}, ("agglo_kmeans",))
    Store(tmp_path).results([unit], lambda unit, known: kept.append(known))
    monkeypatch.setattr("agglo_paper.work.store.versions", lambda: {**versions(), "numpy": "0"})
    Store(tmp_path).results([unit], lambda unit, known: kept.append(known))
    other = Unit(doubled, {"number": 5}, ("agglo_metis",))
    Store(tmp_path).results([other], lambda unit, known: kept.append(known))
    assert kept == [False, False, False]


@pytest.mark.parametrize("family", FAMILIES)
def test_fresh_meshes_fill_the_square_and_can_be_coarsened(family: str) -> None:
    source = f"fresh:{family}:3"
    mesh, again, other = load(source), load(source), load(f"fresh:{family}:4")
    assert mesh.cell_measures.sum() == pytest.approx(1.0)
    assert mesh.fingerprint == again.fingerprint != other.fingerprint
    asked = targets(mesh, source, "levels")
    assert mesh.h < 2 * asked.sizes[0]
    assert asked.counts == tuple(mesh.n_cells // share for share in (4, 16, 64))


def test_targets_of_both_conventions() -> None:
    mesh = load("paper:triangles")
    assert targets(mesh, "paper:triangles", "run").sizes == pytest.approx((sqrt(2) / 4,))
    assert targets(mesh, "paper:triangles", "text").sizes == pytest.approx((sqrt(2) / 2,))
    assert targets(mesh, "paper:triangles", "text").counts == (8,)
    assert targets(mesh, "brain", "brain").sizes == pytest.approx((0.2 * sqrt(2),))


def test_renumbering_keeps_the_mesh() -> None:
    mesh, other = load("paper:voronoi"), load("paper:voronoi", numbering=2)
    assert np.sort(mesh.cell_measures) == pytest.approx(np.sort(other.cell_measures))
    assert not np.allclose(mesh.cell_centroids, other.cell_centroids)
    with pytest.raises(OptionError, match="no family 'hexagons'"):
        load("fresh:hexagons:0")


def test_plain_gradients_to_two_tolerances() -> None:
    found = plain("paper:squares", 1, [1e-6, 1e-8])
    first, second = found["iterations"]
    assert first == pytest.approx(109, abs=1)
    assert second > first
    assert found["smallest"] == second


def test_figures_are_the_same_bytes_each_time(tmp_path: Path) -> None:
    pytest.importorskip("matplotlib")
    few = replace(
        plan.quick(columns(Registry())), columns=[c for c in columns() if c.name in ("gnn", "sweep")]
    )
    for name in ("one.svg", "two.svg"):
        figures.draw_grids(few, ["paper:squares", "paper:triangles"], "run", tmp_path / name)
    one, two = ((tmp_path / name).read_bytes() for name in ("one.svg", "two.svg"))
    assert one == two
    assert b"gnn, 16 parts" in one
    assert samples.paper("squares").name.encode() in one


def test_columns_beside_the_papers_own_can_be_chosen() -> None:
    chosen = {"inertial": ("inertial", {}), "metis:ufactor=30": ("metis", {"ufactor": 30})}
    own, rest = columns()[:4], columns(chosen=chosen)[4:]
    assert columns(chosen=chosen)[:4] == own
    assert [each.name for each in rest if not each.problem][:2] == ["inertial", "metis:ufactor=30"]
    assert rest[1].data()["options"] == {"ufactor": 30}
