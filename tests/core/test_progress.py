"""Progress: every phase from 0 to 1 without a step back, a way to cancel, and a bar on a terminal."""

from __future__ import annotations

import importlib.util
import os
import re
import sys
import time
from collections.abc import Callable, Iterator
from contextlib import suppress
from itertools import pairwise
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest

import agglo_core as agglo
from agglo_core import Diffusion, Progress, samples
from agglo_core.cli.runs import show_progress
from agglo_core.cli.stopping import find_interrupt
from agglo_core.errors import FileError, OptionError
from agglo_core.measure import measure_levels
from agglo_core.mesh import Mesh
from agglo_core.problems.solving import run_solver
from agglo_core.progress import Listener, labelled, part, phase, shown, unwrapped
from agglo_core.registry import Component, default, hookimpl
from agglo_core.registry.attribution import Member, attributed

MESH = samples.voronoi(400, seed=1)
SIZES = {"h_factor": (3.0, 6.0)}


@pytest.fixture
def unhurried(monkeypatch: pytest.MonkeyPatch) -> None:
    """Every report comes through, however fast they follow each other."""
    monkeypatch.setattr("agglo_core.progress.phases._PAUSE", 0.0)


def phases(told: list[Progress]) -> list[tuple[str, list[float]]]:
    """Names and fractions of the phases, one after the other."""
    found: list[tuple[str, list[float]]] = []
    for now in told:
        if now.fraction == 0.0 and (not found or found[-1][1][-1] == 1.0):
            found.append((now.phase, []))
        assert now.phase == found[-1][0], f"{now} within {found[-1][0]}"
        found[-1][1].append(now.fraction)
    return found


def assert_whole(told: list[Progress]) -> list[str]:
    """Every phase runs from 0 to 1 and never back; returns their names."""
    for name, fractions in phases(told):
        assert (fractions[0], fractions[-1]) == (0.0, 1.0), name
        assert all(a <= b for a, b in pairwise(fractions)), name
    return [name for name, _ in phases(told)]


def test_a_phase_reports_from_0_to_1_and_never_back(unhurried: None) -> None:
    told: list[Progress] = []
    with phase(told.append, "counting", "sheep") as notify:
        for fraction, text in ((0.2, "one"), (0.1, ""), (0.7, "two"), (1.7, "")):
            notify(fraction, text)
    assert [now.fraction for now in told] == [0.0, 0.2, 0.2, 0.7, 1.0, 1.0]
    assert [now.text for now in told] == ["sheep", "one", "one", "two", "two", "two"]
    assert {now.phase for now in told} == {"counting"}
    told.clear()
    with pytest.raises(ZeroDivisionError), phase(told.append, "counting") as notify:
        notify(0.5, str(1 / 0))
    assert [now.fraction for now in told] == [0.0]  # it was not finished


def test_few_reports_come_through_and_the_last_one_does() -> None:
    told: list[Progress] = []
    start = time.monotonic()
    with phase(told.append, "counting") as notify:
        for i in range(100_000):
            notify(i / 100_000, str(i))
    assert len(told) <= 3 + 20 * (time.monotonic() - start)
    assert (told[-1].fraction, told[-1].text) == (1.0, "99999")


def test_parts_and_labels() -> None:
    told: list[tuple[float, str]] = []

    def notify(fraction: float, text: str = "") -> None:
        told.append((fraction, text))

    inner = part(part(notify, 1, 2, "level 1"), 0, 4, "UF")
    inner(0.5)
    assert told == [(0.5, "level 1"), (0.5, "level 1: UF"), (0.5 + 0.5 / 8, "level 1: UF")]
    heard: list[Progress] = []
    listen = labelled(heard.append, "metis")
    assert listen is not None
    listen(Progress("writing", 0.5, "a.vtu"))
    assert heard == [Progress("writing", 0.5, "metis: a.vtu")]
    assert labelled(None, "metis") is None


WAYS: dict[str, tuple[dict[str, Any], list[str]]] = {
    "one tree": ({**SIZES, "polish": False}, ["agglomerating"]),
    "sizes": (SIZES, ["agglomerating", "polishing"] * 2),
    "counts": ({"n_parts": (40, 10)}, ["agglomerating", "polishing"] * 2),
    "levels apart": ({**SIZES, "nested": False}, ["agglomerating", "polishing"] * 2),
    "merged and polished": (
        {**SIZES, "merge": True, "post_refiners": ("interface",)},
        ["agglomerating", "merging", "polishing"] * 2,
    ),
    "k-way": (
        {**SIZES, "method": "kway", "bisector": "kmeans"},
        ["partitioning", "agglomerating", "polishing"] * 2,
    ),
}


@pytest.mark.parametrize(("how", "expected"), WAYS.values(), ids=WAYS.keys())
def test_a_measured_and_written_run_reports_every_phase(
    how: dict[str, Any], expected: list[str], tmp_path: Path, unhurried: None
) -> None:
    told: list[Progress] = []
    hierarchy = agglo.agglomerate(MESH, progress=told.append, **({"bisector": "spectral"} | how))
    measure_levels(MESH, hierarchy, progress=told.append)
    for suffix in (".vtu", ".npz"):
        agglo.write(tmp_path / f"a{suffix}", MESH, hierarchy, progress=told.append)
    agglo.quality(MESH, hierarchy.levels[0], progress=told.append)
    before, after = (
        ["building the graph", "ordering the cells"],
        ["measuring", "writing", "writing", "measuring"],
    )
    assert assert_whole(told) == [*before, *expected, *after]
    for name, fractions in phases(told):
        if name in ("agglomerating", "measuring", "writing"):
            assert len({*fractions}) > 2, f"{name} tells {fractions}"
    assert {now.text for now in told if now.phase == "measuring"} >= {"level 0: UF", "level 1: CRc"}
    assert all(now.text.startswith("a.") for now in told if now.phase == "writing")


def test_progress_changes_no_result() -> None:
    plain, watched = (agglo.agglomerate(MESH, progress=each, **SIZES) for each in (None, lambda now: None))
    for ours, theirs in zip(plain.levels, watched.levels, strict=True):
        np.testing.assert_array_equal(ours, theirs)


class Stop(Exception):
    """What a caller may raise to cancel; some of its kinds are those that others catch."""


def at(name: str, error: BaseException, fraction: float = 0.0) -> Callable[[Progress], None]:
    def listen(now: Progress) -> None:
        if now.phase == name and now.fraction >= fraction:
            raise error

    return listen


ERRORS = [
    Stop(),
    KeyboardInterrupt(),
    OSError(28, "mine"),
    FileError("mine"),
    SystemExit(7),
]


@pytest.mark.parametrize("error", ERRORS, ids=lambda error: type(error).__name__)
def test_what_is_raised_stops_the_run_and_passes_unchanged(
    error: BaseException, tmp_path: Path, unhurried: None
) -> None:
    hierarchy = agglo.agglomerate(MESH, **SIZES)
    text = str(error)
    for name in ("building the graph", "ordering the cells", "agglomerating"):
        with pytest.raises(type(error)) as caught:
            agglo.agglomerate(MESH, **SIZES, progress=at(name, error))
        assert caught.value is error
    with pytest.raises(type(error)) as caught:
        measure_levels(MESH, hierarchy, progress=at("measuring", error, 0.3))
    assert caught.value is error
    for suffix in (".vtu", ".npz"):
        for fraction in (0.0, 0.3, 0.6):
            with pytest.raises(type(error)) as caught:
                agglo.write(tmp_path / f"a{suffix}", MESH, hierarchy, progress=at("writing", error, fraction))
            assert (caught.value is error, str(error)) == (True, text)
            assert list(tmp_path.iterdir()) == []


def swallow(listen: Listener | None) -> None:
    """What a careless component may do."""
    with suppress(BaseException), phase(listen, "mine"):
        pass


def wrap(listen: Listener | None) -> None:
    with attributed("bisector x"), phase(listen, "mine"):
        pass


@pytest.mark.parametrize("work", [swallow, wrap])
def test_a_component_cannot_hide_that_it_was_cancelled(work: Callable[[Listener | None], None]) -> None:
    stop = Stop()
    with pytest.raises(Stop) as caught, unwrapped(at("mine", stop)) as listen:
        work(listen)
    assert caught.value is stop
    assert find_interrupt(stop) is None  # the way back from one error to another has an end
    with unwrapped(None) as listen:
        work(listen)
    with pytest.raises(KeyError), unwrapped(lambda now: None):
        raise KeyError("their own")


@pytest.mark.parametrize("name", ["polydg_mg_paper", "polydg_cg"])
def test_solving_reports_iterations_and_residuals(name: str, unhurried: None) -> None:
    hierarchy = agglo.agglomerate(MESH, **SIZES)
    solver, told = Member(default().build("solver", name), f"solver {name}"), list[Progress]()
    solution = run_solver(solver, Diffusion(), hierarchy, told.append)
    names = assert_whole(told)
    assert (names[0], names[-1]) == ("assembling", "solving")
    solving = [now for now in told if now.phase == "solving"]
    assert len(solving) > solution.iterations
    assert re.search(r"iteration \d+, relative residual \d\.\de-0[3-9]", solving[-2].text)
    np.testing.assert_array_equal(solution.x, run_solver(solver, Diffusion(), hierarchy).x)
    stop = Stop()
    with pytest.raises(Stop) as caught:
        run_solver(solver, Diffusion(), hierarchy, at("solving", stop, 0.2))
    assert caught.value is stop


def test_solvers_and_formats_of_plugins_need_not_report(tmp_path: Path, unhurried: None) -> None:
    class Silent:
        def solve(self, problem: object, hierarchy: object) -> Any:
            return default().build("solver", "polydg_cg").solve(problem, hierarchy)

    told: list[Progress] = []
    run_solver(Member(Silent(), "solver silent"), Diffusion(), agglo.agglomerate(MESH, **SIZES), told.append)
    assert assert_whole(told) == ["solving"]


class Told:
    """A format that tells how much it has written."""

    suffixes, lossless, reports_progress = (".told",), False, True

    def read(self, path: Path) -> Mesh:
        return samples.squares(1)

    def write(self, path: Path, mesh: Mesh, hierarchy: object = None, *, notify: Any) -> None:
        notify(0.25, "a quarter")
        path.write_text("told")


@pytest.fixture
def telling(monkeypatch: pytest.MonkeyPatch) -> Iterator[None]:
    monkeypatch.setitem(sys.modules, "told_home", SimpleNamespace(Told=Told))
    offered = [Component("format", "told", "told_home:Told")]
    default().register(SimpleNamespace(agglo_components=hookimpl(lambda: offered)), "telling")
    yield
    default().unregister("telling")


def test_formats_of_plugins_may_report(telling: None, tmp_path: Path, unhurried: None) -> None:
    told: list[Progress] = []
    agglo.write(tmp_path / "a.told", MESH, progress=told.append)
    assert Progress("writing", 0.25, "a.told: a quarter") in told
    with pytest.raises(Stop):
        agglo.write(tmp_path / "b.told", MESH, progress=at("writing", Stop(), 0.2))
    assert [file.name for file in tmp_path.iterdir()] == ["a.told"]


def test_a_listener_is_a_function(tmp_path: Path) -> None:
    mesh = samples.squares(2)
    for call in (
        lambda: agglo.agglomerate(mesh, n_parts=2, progress=3),  # type: ignore[arg-type]
        lambda: agglo.write(tmp_path / "m.npz", mesh, progress="bar"),  # type: ignore[arg-type]
    ):
        with pytest.raises(OptionError, match="progress must be a function of a Progress, given"):
            call()


def test_verbose_writes_lines_where_there_is_no_terminal(capsys: pytest.CaptureFixture[str]) -> None:
    told: list[Progress] = []
    agglo.agglomerate(MESH, **SIZES, polish=False, verbose=True, progress=told.append)
    out, err = capsys.readouterr()
    lines = err.splitlines()
    assert out == ""
    assert all(line.startswith("agglo: ") for line in lines)
    assert re.fullmatch(r"agglo: agglomerating 100% level 2 of 2: \d+ parts", lines[-1])
    assert len(lines) == 2 * len(assert_whole(told))
    agglo.agglomerate(MESH, **SIZES)
    assert capsys.readouterr() == ("", "")  # a library does not print by itself
    with shown(lines=False) as listen:
        assert listen is None


def test_pictures_report_runs_and_levels(tmp_path: Path, unhurried: None) -> None:
    pytest.importorskip("matplotlib")
    told: list[Progress] = []
    agglo.plot.draw(
        MESH, {"mine": agglo.agglomerate(MESH, **SIZES)}, tmp_path / "a.png", progress=told.append
    )
    assert assert_whole(told) == ["drawing"]
    assert {now.text for now in told} >= {"mine: level 0", "mine: level 1", "a.png"}


ON_TERMINAL = """
import os, sys
import agglo_core.progress.phases as phases
phases._PAUSE = 0.0
from agglo_core.cli import main
main(["run", "squares:n=24", "--bisector", "kmeans", "--h-factor", "4", "-o", "a.vtu", *sys.argv[1:]])
"""


NOTE_BESIDE_A_BAR = """
import logging
from agglo_core.cli.output.console import notices
from agglo_core.progress import Progress, shown
with notices(), shown() as listen:
    listen(Progress("reading", 0.5, "x.vtu"))
    logging.getLogger("agglo").warning("equal points merged: 3")
"""

NOTHING_TOLD = """
from agglo_core.progress import shown
with shown():
    pass
"""


def on_terminal(folder: Path, *arguments: str, code: str = ON_TERMINAL) -> str:
    """What Python code shows on a terminal of 100 columns, without its control sequences."""
    import pty

    pid, terminal = pty.fork()
    if pid == 0:
        os.chdir(folder)
        os.environ |= {"TERM": "xterm", "COLUMNS": "100", "PYTHONPATH": os.pathsep.join(sys.path)}
        os.execv(sys.executable, [sys.executable, "-c", code, *arguments])
    shown = b""
    while True:
        try:
            read = os.read(terminal, 1 << 16)
        except OSError:  # Linux's word for the end
            break
        if not read:
            break
        shown += read
    assert os.waitstatus_to_exitcode(os.waitpid(pid, 0)[1]) == 0
    return re.sub(r"\x1b\[[0-9;?]*[a-zA-Z]", "", shown.decode())


terminals = pytest.mark.skipif(
    importlib.util.find_spec("pty") is None or os.name != "posix", reason="no terminals"
)


@terminals
def test_a_note_stands_on_a_line_of_its_own_above_the_bar(tmp_path: Path) -> None:
    text = on_terminal(tmp_path, code=NOTE_BESIDE_A_BAR)
    assert re.search(r"[\r\n]warning: equal points merged: 3\r?\n", text)


@terminals
def test_a_bar_without_reports_leaves_no_line(tmp_path: Path) -> None:
    assert on_terminal(tmp_path, code=NOTHING_TOLD) == ""


@pytest.mark.slow
@terminals
def test_a_terminal_shows_phase_and_percent(tmp_path: Path) -> None:
    text = on_terminal(tmp_path)
    for name in ("reading", "agglomerating", "measuring", "writing"):
        assert re.search(rf"{name} +\S+ +\d+%", text), name
    assert text.index("measuring") < text.index("writing") < text.index("wrote a.vtu")
    with show_progress(quiet=True) as listen:
        assert listen is None
