"""``python -m shape_study levels`` and ``… solids``: several levels, finite volumes in space, their pages."""

from __future__ import annotations

import json
import math
from itertools import pairwise
from pathlib import Path

import numpy as np
import pytest
from click.testing import CliRunner

from agglo_core import samples
from shape_study.__main__ import study
from shape_study.levels import KINDS, Kind, measured_levels, metrics_of_levels, target_of
from shape_study.partitions import RECIPES
from shape_study.solids import (
    SOLID_SOLVERS,
    approximation_error,
    finite_volumes,
    measured_solids,
)
from shape_study.work import SOLVERS, metrics_of


@pytest.mark.parametrize("kind", KINDS)
@pytest.mark.parametrize(
    "source", ["voronoi:n=300,seed=1", pytest.param("voronoi3d:n=300,seed=1", marks=pytest.mark.slow)]
)
def test_levels_are_nested_and_have_the_given_size_or_number(source: str, kind: Kind) -> None:
    mesh = samples.from_spec(source)
    target = target_of(mesh, kind, [4, 16, 64])
    for name in ("kmeans", "branches", "kmeans k-way, annealed"):
        levels = RECIPES[name].levels(mesh, target, 1)
        assert len(levels) == 3
        for fine, coarse in pairwise(levels):
            assert len(np.unique(np.stack([fine, coarse]), axis=1).T) == fine.max() + 1
        if kind == "counts":
            assert [labels.max() + 1 for labels in levels] == [75, 18, 4]
        else:
            alone = mesh.cell_diameters.max()
            widths = [mesh.coarsen(labels).cell_diameters.max() for labels in levels]
            sizes = np.sqrt(mesh.dim) * (np.array([4, 16, 64]) / 300) ** (1 / mesh.dim)
            np.testing.assert_allclose(target["h_star"], sizes)
            assert (widths <= np.maximum(sizes, alone) * (1 + 1e-9)).all()


def test_metrics_of_levels_are_means() -> None:
    mesh = samples.squares(8)
    quarters, whole = np.arange(64) // 4, np.arange(64) // 16
    target = {"h_star": [1.0, 2.0]}
    values, better = metrics_of_levels(mesh, [quarters, whole], target)
    fine, coarse = metrics_of(mesh, quarters)[0], metrics_of(mesh, whole)[0]
    assert values["CR"] == pytest.approx((fine["CR"] + coarse["CR"]) / 2)
    assert values["interface"] == pytest.approx(math.sqrt(fine["interface"] * coarse["interface"]))
    assert (values["parts"], better["parts"]) == (20.0, "low")
    widths = [math.hypot(4 / 8, 1 / 8), math.hypot(1, 2 / 8) / 2]
    assert values["diameter_ratio"] == pytest.approx(sum(widths) / 2)


def test_iterations_with_four_levels_are_more_for_bad_parts() -> None:
    asked = ("voronoi:n=300,seed=2", "counts", [4, 16, 64])
    good, bad = (measured_levels(*asked, name, 0, [1])["outcomes"] for name in ("kmeans", "branches"))
    assert set(good) == {f"{name} {what} p1" for name in SOLVERS for what in ("κ = 1", "κ jumps")}
    assert good["paper κ = 1 p1"] < bad["paper κ = 1 p1"]


def test_finite_volumes_of_cubes_are_the_seven_point_stencil() -> None:
    mesh = samples.boxes(4)
    A = finite_volumes(mesh, np.ones(64)).A.toarray()
    steps = np.rint(mesh.cell_centroids * 4 - 0.5).astype(int)
    away = np.abs(steps[:, None] - steps[None, :]).sum(axis=2)
    outer = ((steps == 0).sum(axis=1) + (steps == 3).sum(axis=1)) * 1.0
    slow = np.where(away == 1, -1.0, 0.0) + np.diag(6.0 + outer)  # a wall is half as far as a neighbour
    np.testing.assert_allclose(4 * A, slow, atol=1e-12)


def test_finite_volumes_are_exact_across_a_jump() -> None:
    mesh = samples.boxes(4)
    x = mesh.cell_centroids[:, 0]
    kappa = np.where(x < 0.5, 1.0, 10.0)
    problem = finite_volumes(mesh, kappa)
    flux = np.where(x < 0.5, x, 0.5 + (x - 0.5) / 10.0)  # u with κ u' = 1
    inner = ((mesh.cell_centroids > 0.25) & (mesh.cell_centroids < 0.75)).all(axis=1)
    np.testing.assert_allclose((problem.A @ flux)[inner], 0.0, atol=1e-12)
    assert (problem.A != problem.A.T).nnz == 0
    assert problem.b.sum() == pytest.approx(1.0)


def test_linear_functions_on_single_cells_and_on_all_come_up_to_what_they_can() -> None:
    mesh = samples.boxes(4)
    assert approximation_error(mesh, np.arange(64)) == pytest.approx(0.0, abs=1e-12)
    values = np.sin(np.pi * mesh.cell_centroids).prod(axis=1)
    mean = values.mean()  # the best linear function, by symmetry
    slow = np.sqrt(((values - mean) ** 2).sum() / (values**2).sum())
    assert approximation_error(mesh, np.zeros(64, int)) == pytest.approx(slow)


@pytest.mark.slow
def test_solids_are_measured_and_bad_shapes_cost() -> None:
    asked = ("voronoi3d:n=400,seed=3", "counts", [32])
    good, bad = (measured_solids(*asked, name, 0) for name in ("kmeans", "branches"))
    names = {f"{name} {what}" for name in SOLID_SOLVERS for what in ("κ = 1", "κ jumps")}
    assert set(good["outcomes"]) == names | {"approximation"}
    assert good["metrics"]["isoperimetric"] > bad["metrics"]["isoperimetric"]
    for outcome in ("approximation", "smoothed κ = 1", "paper κ = 1"):
        assert good["outcomes"][outcome] < bad["outcomes"][outcome]
    by_size = measured_solids(asked[0], "sizes", [32], "kmeans", 0)
    assert by_size["outcomes"]["parts"] == by_size["metrics"]["parts"] >= 12


@pytest.mark.slow
@pytest.mark.parametrize(
    ("what", "keys"),
    [
        ("levels", ["counts", "sizes"]),
        ("solids", ["two-counts", "two-sizes", "four-counts", "four-sizes"]),
    ],
)
def test_the_other_studies_write_their_pages(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, what: str, keys: list[str]
) -> None:
    tiny = ["--meshes", "1", "--cells", "80", "--partitions", "4"] + ["--degrees", "1"] * (what == "levels")
    monkeypatch.chdir(tmp_path)
    assert CliRunner().invoke(study, [what, *tiny, "-o", "out"]).exit_code == 0
    data = json.loads((tmp_path / "out" / f"{what}.json").read_text(encoding="utf-8"))
    names = [table["name"] for table in data["tables"]]
    assert [name for name in names if name.endswith("-all")] == [f"{key}-all" for key in keys]
    assert [f"{key}-partial" in names for key in keys] == [key.endswith("sizes") for key in keys]
    text = (tmp_path / "out" / f"{what}.md").read_text(encoding="utf-8")
    assert f"Made by `python -m shape_study {what} --meshes 1 --cells 80" in text
    figures = [f"{what}-{key}.svg" for key in keys]
    assert all((tmp_path / "out" / name).exists() == (name in text) for name in figures)


def test_solids_have_no_degrees() -> None:
    done = CliRunner().invoke(study, ["solids", "--degrees", "1"])
    assert done.exit_code == 2
    assert "--degrees is for the plane" in done.stderr
