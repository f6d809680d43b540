"""``agglo solve --write-system``: what other programs get, and what comes back as a linear problem."""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path
from types import SimpleNamespace

import numpy as np
import pytest
from cell_values import CellValues
from command_line import Agglo
from scipy import sparse
from scipy.io import mmread

from agglo_core import Component, FileError, OptionError, agglomerate, hookimpl, samples
from agglo_core.io.system_files import write_system_and_levels
from agglo_core.problems import Diffusion, Linear, System, read_problem
from agglo_core.registry import default

COMPONENTS = [
    Component("solver", "fluxes", "cell_values:Fluxes"),
    Component("solver", "bare", "cell_values:Bare"),
]
ASKED = ("solve", "squares:n=6", "--parts", "9,4", "--no-cg", "--solver")


@pytest.fixture(autouse=True)
def _strangers() -> Iterator[None]:
    plugin = SimpleNamespace(agglo_components=hookimpl(lambda: COMPONENTS))
    default().register(plugin, "strangers")
    yield
    default().unregister("strangers")


@pytest.fixture
def mine() -> System:
    """The system of the strangers' solver."""
    return CellValues().assemble(Diffusion(source=8.0), samples.squares(6))


def test_an_npz_archive_holds_matrix_and_levels(agglo: Agglo, mine: System) -> None:
    done = agglo(*ASKED, "fluxes", "--write-system", "s.npz")
    assert done.code == 0
    assert "wrote s.npz" in done.out
    assert abs(sparse.load_npz("s.npz") - mine.A).max() == 0.0
    levels = agglomerate(samples.squares(6), n_parts=(9, 4)).levels
    with np.load("s.npz") as found:
        assert found["b"].tolist() == mine.b.tolist()
        assert found["block_offsets"].tolist() == list(range(37))
        assert found["near_null"].tolist() == [[1.0]] * 36
        assert [found[f"level_{k}"].tolist() for k in (0, 1)] == [each.tolist() for each in levels]


def test_matrix_market_files(agglo: Agglo, mine: System) -> None:
    assert agglo(*ASKED, "fluxes", "--write-system", "s.mtx").code == 0
    names = ["s", "s_b", "s_block_offsets", "s_level_0", "s_level_1", "s_near_null"]
    assert sorted(path.stem for path in Path().iterdir()) == names
    assert abs(mmread("s.mtx") - mine.A).max() == 0.0
    assert mmread("s_b.mtx")[:, 0].tolist() == mine.b.tolist()
    assert mmread("s_level_1.mtx").max() == 3


@pytest.mark.parametrize(("suffix", "rhs"), [("npz", "s.npz"), ("mtx", "s_b.mtx")])
def test_what_is_written_is_a_linear_problem(agglo: Agglo, suffix: str, rhs: str) -> None:
    first = agglo(*ASKED, "fluxes:tolerance=1e-9", "--write-system", f"s.{suffix}", "--json").data
    Path("again.toml").write_text(f'kind = "linear"\nmatrix = "s.{suffix}"\nrhs = "{rhs}"\n')
    again = agglo(
        *ASKED, "fluxes:tolerance=1e-9", "--problem", "again.toml", "--write-system", "t.npz", "--json"
    )
    assert again.data["energy"] == pytest.approx(first["energy"], rel=1e-9)
    with np.load("t.npz") as found:
        assert "near_null" not in found  # a matrix alone does not tell
        assert (
            abs(
                sparse.load_npz("t.npz")
                - sparse.csr_array(read_problem(Path("again.toml"), samples.squares(6)).A)
            ).max()
            == 0.0
        )


def test_cells_of_unequal_numbers_of_unknowns(tmp_path: Path) -> None:
    mesh, offsets = samples.squares(2), np.array([0, 1, 3, 4, 6])
    A = sparse.csr_array(np.diag(np.arange(1.0, 7.0)))
    write_system_and_levels(tmp_path / "s.npz", System(A, np.ones(6), offsets, mesh), [np.zeros(4, int)])
    table = {"matrix": "s.npz", "rhs": "s.npz"}
    assert Linear.from_table(table, mesh, tmp_path).block_offsets.tolist() == offsets.tolist()
    with pytest.raises(OptionError, match=r"block_offsets of .* do not divide its 6 rows among 9 cells"):
        Linear.from_table(table, samples.squares(3), tmp_path)
    assert len(Linear.from_table({**table, "unknowns": 2}, samples.strip(3), tmp_path).b) == 6
    sparse.save_npz(tmp_path / "A.npz", A)
    with pytest.raises(FileError, match=r"rhs: .*A\.npz: array 'b' is missing"):
        Linear.from_table({"matrix": "A.npz", "rhs": "A.npz"}, mesh, tmp_path)


@pytest.mark.parametrize(
    ("solver", "file", "message"),
    [
        ("fluxes", "s.mat", "s.mat: the suffix of a system file must be .npz or .mtx"),
        ("fluxes", "no/s.npz", "the folder no does not exist"),
        (
            "bare",
            "s.npz",
            "bare has no discretisation to interpret the unknowns of problem kind diffusion: --write-sy",
        ),
    ],
)
def test_bad_requests_leave_nothing(agglo: Agglo, solver: str, file: str, message: str) -> None:
    done = agglo(*ASKED, solver, "--write-system", file)
    assert (done.code, done.out) == (2, "")
    assert message in done.err
    assert list(Path().iterdir()) == []
