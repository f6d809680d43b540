"""``python -m value_of_cuts``: features, cuts, training and the table."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from click.testing import CliRunner

from agglo_core import agglomerate, samples
from agglo_core.authoring import OptionError
from value_of_cuts import compare
from value_of_cuts.__main__ import study
from value_of_cuts.cuts import Policy, ValueBisector, cells_of, cut, fits, project, recursion
from value_of_cuts.features import describe, join, new_room, no_cells, setup_for
from value_of_cuts.train import Effort, blank, train

pytestmark = pytest.mark.slow  # the kernels of the study are compiled for these tests alone

TINY = Effort(meshes=2, validation=2, recursions=1, noise=(0.1,), steps=20)


def described(dim: int, frame: np.ndarray, n: int = 4, h_star: float = 1.0) -> tuple[np.ndarray, float]:
    """Return the inputs of the network and the largest width of a unit square or cube of n cells a side."""
    mesh = samples.squares(n) if dim == 2 else samples.boxes(n)
    cells, setup, room = cells_of(mesh.graph), setup_for(dim), new_room()
    _, each = project(cells, np.arange(mesh.n_cells), setup.axes @ frame, h_star)
    whole = no_cells(1)
    for k in range(mesh.n_cells):
        join(whole, 0, each, k)
    width = describe(whole, 0, setup, room)
    return room.inputs[: len(blank(dim).w1)].copy(), width


def test_features_of_a_square() -> None:
    inputs, width = described(2, np.eye(2), h_star=0.5)
    diagonal, between = 2 * np.sqrt(2), 2 * (np.cos(np.pi / 8) + np.sin(np.pi / 8))
    # Variances of the centroids of 4 × 4 cells of side 0.5: 0.25 (16 - 1) / 12.
    deviations = [np.sqrt(2 * 0.3125), np.sqrt(0.3125)]
    widths = [diagonal, between, 2, between, diagonal, between, 2, between]
    np.testing.assert_allclose(inputs, [np.log(4), *widths, 0.5, *deviations], rtol=1e-5)
    assert width == pytest.approx(diagonal)


def test_features_of_a_cube() -> None:
    inputs, width = described(3, np.eye(3))
    variance = 0.25**2 * (16 - 1) / 12
    deviations = np.sqrt(3 * variance), (3 * variance**2) ** 0.25, np.sqrt(variance)
    faces, rest = [np.sqrt(2)] * 6, [0.25, *deviations]
    np.testing.assert_allclose(inputs, [0, 1, 1, 1, *[np.sqrt(3)] * 4, *faces, *rest], rtol=1e-5, atol=1e-6)
    assert width == pytest.approx(np.sqrt(3))


@pytest.mark.parametrize("dim", [2, 3])
def test_features_do_not_depend_on_symmetries_of_the_axes(dim: int) -> None:
    frame = np.linalg.qr(np.random.default_rng(1).normal(size=(dim, dim)))[0]
    turns = {2: np.array([[1, -1], [1, 1]]) / np.sqrt(2), 3: np.array([[0, 1.0, 0], [0, 0, -1], [1, 0, 0]])}
    first, second = described(dim, frame)[0], described(dim, np.ascontiguousarray(turns[dim] @ frame))[0]
    np.testing.assert_allclose(first, second, rtol=1e-4, atol=1e-5)


@pytest.mark.parametrize("dim", [2, 3])
def test_the_cut_with_the_most_inertia_halves_a_row(dim: int) -> None:
    cells = cells_of((samples.squares(4) if dim == 2 else samples.boxes(4)).graph)
    low = cells.centroids.min(axis=0)
    row = np.flatnonzero((cells.centroids[:, 1:] < low[1:] + 0.1).all(axis=1))
    row, side = row[np.argsort(cells.centroids[row, 0])], np.empty(4, np.int64)
    cut(cells, row, setup_for(dim), Policy(1.0, False, 0.0), blank(dim), side)
    np.testing.assert_array_equal(side == side[0], [True, True, False, False])


@pytest.mark.parametrize("dim", [2, 3])
def test_recursions_count_the_parts_of_each_piece(dim: int) -> None:
    cells = cells_of((samples.squares(4) if dim == 2 else samples.boxes(4)).graph)
    diagonal = np.sqrt(dim) / 2
    assert fits(cells, np.arange(2), diagonal)
    assert not fits(cells, np.arange(8), diagonal)
    frame = np.eye(dim)
    inputs, widths, parts = recursion(
        cells, setup_for(dim), frame, Policy(diagonal, False, 0.0), blank(dim), 0
    )
    leaves = 2**dim
    assert parts[0] == leaves
    assert len(parts) == 2 * leaves - 1
    assert sorted(parts) == sorted([1] * leaves + [leaves >> k for k in range(dim) for _ in range(1 << k)])
    np.testing.assert_allclose(np.exp(inputs[parts == 1, 0]), 1.0 / (2 * diagonal) ** dim, rtol=1e-5)
    assert (widths[parts == 1] <= 1.0 + 1e-6).all()


@pytest.mark.parametrize("dim", [2, 3])
def test_a_trained_network_makes_connected_parts_no_wider_than_h(dim: int) -> None:
    reports: list[str] = []
    network = train(dim, 0, reports.append, TINY)
    assert [line.partition(":")[0] for line in reports] == ["most inertia between", "round 0", "round 1"]
    mesh = samples.voronoi(300, 5) if dim == 2 else samples.random_tetrahedra(80, 5)
    bisector, size = ValueBisector(network), 0.4 if dim == 2 else 0.7
    labels = agglomerate(mesh, h_star=size, bisector=bisector).levels[0]
    assert labels.max() > 2
    assert len(bisector.seconds) > 1
    np.testing.assert_array_equal(mesh.graph.components(labels), labels)
    assert mesh.graph.part_diameters(labels).max() <= size * (1 + 1e-9)


def test_the_table_has_a_column_for_each_family(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    family = {"squares": (lambda seed: samples.squares(8 + seed), 0.6)}
    monkeypatch.setattr(compare, "FAMILIES", {2: family})
    file = tmp_path / "blank.npz"
    np.savez(file, **blank(2)._asdict())
    result = CliRunner().invoke(study, ["compare", str(file), str(file), "--meshes", "2", "--seed", "0"])
    assert result.exit_code == 0, result.output
    head, _, *rows = (line.strip("| ").split(" | ") for line in result.output.splitlines())
    assert head[1:] == ["squares"]
    assert len(rows) == len(compare.OTHERS) - 1 + 3
    least, most = rows[-2][1].split(", ")
    assert least == most == rows[-3][1].partition(" ")[0]


def test_a_bisector_without_a_size_is_refused() -> None:
    with pytest.raises(OptionError, match="expected a target h_star, given none"):
        agglomerate(samples.squares(4), n_parts=2, bisector=ValueBisector(blank(2)))
