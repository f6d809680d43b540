"""The command line: what each command prints and leaves, exit codes, errors in one line."""

from __future__ import annotations

import json
import math
import re
from collections.abc import Iterator
from dataclasses import replace
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import click
import numpy as np
import pytest
from command_line import Agglo

from agglo_core import Hierarchy, Mesh, samples, write
from agglo_core.agglomeration import one_call
from agglo_core.cli import main
from agglo_core.cli.options.specs import parse_spec
from agglo_core.errors import MeshError, OptionError
from agglo_core.registry import CORE_COMMANDS, Command, Component, default as default_registry, hookimpl


@click.command()
@click.argument("word")
@click.option("--exit", "code", type=int)
@click.pass_context
def shout(context: click.Context, word: str, code: int | None) -> None:
    """Say a word loudly."""
    if word == "bad":
        raise MeshError("cell 3\nhas no area")
    if word == "bug":
        raise ZeroDivisionError
    click.echo(word.upper())
    if code is not None:
        context.exit(code)


@pytest.fixture
def plugin_commands(monkeypatch: pytest.MonkeyPatch) -> Iterator[None]:
    """A plugin with a good command, one without a target, and one whose name is taken."""
    home = SimpleNamespace(shout=shout)
    monkeypatch.setitem(__import__("sys").modules, "shouting", home)
    names = {"shout": "shouting:shout", "absent": "shouting:absent", "run": "shouting:shout"}
    commands = [Command(name, target, f"Says {name}.") for name, target in names.items()]
    plugin = SimpleNamespace(agglo_commands=hookimpl(lambda: commands))
    default_registry().register(plugin, "shouting", distribution="loud", version="7")
    yield
    default_registry().unregister("shouting")


def test_help_lists_the_commands(agglo: Agglo, plugin_commands: None) -> None:
    code, out, _ = agglo("--help")
    assert code == 0
    assert agglo() == agglo("-h") == (0, out, "")
    for name in (*CORE_COMMANDS, "shout", "absent", "shouting/run"):
        assert f"  {name} " in out
    assert "Says shout." in out
    assert agglo("--version").out.startswith("agglo, version ")


@pytest.mark.parametrize("command", CORE_COMMANDS)
def test_each_command_explains_itself(agglo: Agglo, command: str) -> None:
    code, out, _ = agglo(command, "--help")
    assert code == 0
    assert out.startswith(f"Usage: agglo {command}")
    assert agglo(command, "-h") == (0, out, "")


def test_commands_of_plugins_run(agglo: Agglo, plugin_commands: None) -> None:
    assert agglo("shout", "hello") == (0, "HELLO\n", "")
    assert agglo("shouting/run", "hello").out == "HELLO\n"
    assert agglo("shout", "no", "--exit", "3").code == 3
    assert "Say a word loudly." in agglo("shout", "--help").out
    assert agglo("shout", "-h") == agglo("shout", "--help")
    missing, usage = agglo("shout").err.splitlines()
    assert missing == "error: Missing argument 'WORD'."
    assert usage == "usage: agglo shout [OPTIONS] WORD (help: agglo shout -h)"
    assert agglo("shout", "bad") == (2, "", "error: cell 3 has no area\n")


def test_a_broken_command_is_explained(agglo: Agglo, plugin_commands: None) -> None:
    code, _, err = agglo("absent")
    assert code == 2
    assert err.startswith("error: command 'absent' (plugin 'shouting', distribution loud 7)")


def test_a_bug_keeps_its_traceback(plugin_commands: None) -> None:
    with pytest.raises(ZeroDivisionError):
        main(["shout", "bug"])


def test_unknown_commands_say_what_there_is(agglo: Agglo) -> None:
    code, _, err = agglo("plugns")
    assert code == 2
    assert err.startswith("error: no command 'plugns' (did you mean 'plugins'?); accepted: demo")
    assert err.endswith("\nusage: agglo [OPTIONS] [COMMAND] [ARGS]... (help: agglo -h)\n")


@pytest.mark.parametrize(
    ("arguments", "usage"),
    [
        (["run"], "agglo run [OPTIONS] MESH|SAMPLE (help: agglo run -h)"),
        (["run", "squares:4", "--part", "2"], "agglo run [OPTIONS] MESH|SAMPLE (help: agglo run -h)"),
        (["run", "squares:4", "--explode", "2"], "agglo run [OPTIONS] MESH|SAMPLE (help: agglo run -h)"),
        (["mesh", "squares:4"], "agglo mesh [OPTIONS] SAMPLE (help: agglo mesh -h)"),
        (["model", "nfo"], "agglo model [OPTIONS] COMMAND [ARGS]... (help: agglo model -h)"),
        (["model", "info"], "agglo model info [OPTIONS] FILE (help: agglo model info -h)"),
    ],
)
def test_wrong_calls_end_with_the_usage(agglo: Agglo, arguments: list[str], usage: str) -> None:
    code, out, err = agglo(*arguments)
    assert (code, out, err.count("\n")) == (2, "", 2)
    assert err.endswith(f"\nusage: {usage}\n")


def test_a_group_without_subcommand_prints_its_help(agglo: Agglo) -> None:
    code, out, err = agglo("model")
    assert (code, out) == (2, "")
    assert err == agglo("model", "-h").out


def test_help_has_groups_of_options(agglo: Agglo) -> None:
    heads = {c: re.findall(r"^(\w.*):$", agglo(c, "-h").out, re.MULTILINE) for c in CORE_COMMANDS}
    usual = ["Targets", "Method", "Rules for parts", "Running"]
    assert heads.pop("run") == [*usual, "Output and help"]
    assert heads.pop("solve") == heads.pop("compare") == [*usual, "Solver", "Output and help"]
    assert set(map(tuple, heads.values())) == {("Options",)}


def test_each_group_has_its_options(agglo: Agglo) -> None:
    groups = re.split(r"^\w.*:$", agglo("run", "-h").out, flags=re.MULTILINE)[1:]
    flags = [re.findall(r"^  (?:-\w, )?--([\w-]+)", text, re.MULTILINE) for text in groups]
    assert flags[0] == ["h-star", "h-factor", "parts", "cells-per-part"]
    assert flags[1][:4] == ["bisector", "refiner", "fixer", "method"]
    assert (flags[2][0], flags[2][-1], len(flags[2])) == ("constraint", "lines", 15)
    assert flags[3] == ["config", "allow-code", "threads", "independent-of-ranks"]
    assert flags[4] == [
        *("metrics", "output", "compress", "plot", "explode", "report", "json", "quiet", "help")
    ]


def test_plugins_are_listed(agglo: Agglo) -> None:
    default_registry().register(SimpleNamespace(), "hollow")
    try:
        table, verbose, data = agglo("plugins"), agglo("plugins", "-v"), agglo("plugins", "--json")
    finally:
        default_registry().unregister("hollow")
    assert (table.code, verbose.code, data.code) == (0, 0, 0)
    for text in (table.out, verbose.out):
        assert "no hook is implemented" in text
    records = {(r["kind"], r["name"]): r for r in json.loads(data.out)}
    assert records["plugin", "hollow"]["state"] == "broken"
    kmeans = records["bisector", "kmeans"]
    assert (kmeans["distribution"], kmeans["state"], kmeans["plugin"]) == ("agglo", "ok", "kmeans")
    assert kmeans["target"].startswith("agglo_kmeans")
    assert kmeans["target"] in verbose.out


def test_specs_are_read() -> None:
    assert parse_spec("kmeans") == ("kmeans", {})
    assert parse_spec("theirs/metis:ufactor=30,contig=True,tol=1e-3,seed=none,mode=fast") == (
        "theirs/metis",
        {"ufactor": 30, "contig": True, "tol": 1e-3, "seed": None, "mode": "fast"},
    )
    assert parse_spec("a:path=x=y")[1] == {"path": "x=y"}
    for wrong in ("", ":n=1", "a:n", "a:n=", "a:=1", "a:n=1,,m=2", "a:n=1,n=2"):
        with pytest.raises(OptionError):
            parse_spec(wrong)


def test_run_prints_json_of_one_form(agglo: Agglo) -> None:
    code, out, _ = agglo("run", "squares:n=8", "--bisector", "kmeans", "--parts", "16,4", "--json")
    assert code == 0
    data = json.loads(out)
    assert set(data) == {"mesh", "runs"}
    assert (set(data["mesh"]), data["mesh"]["cells"]) == ({"name", "cells", "h0"}, 64)
    assert data["mesh"]["h0"] == pytest.approx(2**0.5 / 8)
    (run,) = data["runs"]
    assert set(run) == {"bisector", "levels", "seconds", "statistics"}
    assert run["bisector"] == "kmeans"
    ratios = {"UF", "CR", "CRc", "J", "isoperimetric", "diameter_ratio"}
    keys = {"target", "parts", "min_cells", "max_cells", "max_diameter", "connected", *ratios}
    assert all(set(level) == keys for level in run["levels"])
    assert [level["parts"] for level in run["levels"]] == [16, 4]
    coarse = run["levels"][1]
    assert [coarse[key] for key in ("UF", "CR", "CRc", "connected")] == pytest.approx(
        [1, 0.5**0.5, 0.5**0.5, 1], abs=1e-3
    )
    assert coarse["max_diameter"] == pytest.approx(2**0.5 / 2)
    assert coarse["J"] == pytest.approx(3 / math.pi)
    assert coarse["diameter_ratio"] is None


def test_solids_have_ratios_of_balls(agglo: Agglo) -> None:
    code, out, _ = agglo("run", "boxes:n=2", "--parts", "2", "--json")
    assert code == 0
    (level,) = json.loads(out)["runs"][0]["levels"]
    assert [level["CR"], level["CRc"]] == pytest.approx([1 / 3, 1 / 3])
    assert level["isoperimetric"] == pytest.approx(36 * math.pi * 0.5**2 / 4**3)
    assert 0 < level["J"] < 1
    assert level["parts"] == 2


def test_two_bisectors_are_compared_written_and_drawn(agglo: Agglo, tmp_path: Path) -> None:
    pytest.importorskip("pymetis")
    pytest.importorskip("matplotlib")
    two = ["--bisector", "kmeans", "--bisector", "metis", "--cells-per-part", "16"]
    code, out, _ = agglo("run", "squares:n=8", *two, "-o", "out.vtu", "--plot", "out.png")
    assert code == 0
    assert "kmeans" in out
    assert "metis" in out
    assert {"out_kmeans.vtu", "out_metis.vtu", "out.png"} <= {file.name for file in tmp_path.iterdir()}
    assert not Path("out.vtu").exists()
    code, out, _ = agglo("quality", "out_kmeans.vtu", "--json")
    assert code == 0
    assert [level["parts"] for level in json.loads(out)["levels"]] == [4]


def test_quiet_runs_print_nothing(agglo: Agglo, tmp_path: Path) -> None:
    assert agglo("mesh", "squares:n=4", "-o", "in.vtu", "--quiet") == (0, "", "")
    assert agglo("run", "in.vtu", "--parts", "4", "-o", "out.npz", "--quiet") == (0, "", "")
    levels = json.loads(agglo("quality", "out.npz", "--json").out)["levels"]
    assert [level["parts"] for level in levels] == [4]


def test_cells_of_a_plain_mesh_are_measured(agglo: Agglo) -> None:
    assert "16 cells" in agglo("mesh", "squares:n=4", "-o", "in.vtu").out
    (level,) = json.loads(agglo("quality", "in.vtu", "--json").out)["levels"]
    assert (level["parts"], level["level"]) == (16, "cells")
    assert level["CR"] == pytest.approx(0.5**0.5, abs=1e-3)
    assert "cells" in agglo("quality", "in.vtu").out


def test_labels_in_texts_are_measured(agglo: Agglo) -> None:
    agglo("mesh", "squares:n=4", "-o", "in.vtu")
    Path("fine.part.8").write_text("".join(f"{i // 2}\n" for i in range(16)))
    Path("coarse.txt").write_text("3\n" * 8 + "\n" + "5\r\n" * 8)  # two parts; the others have no cells
    both = ["--labels", "fine.part.8", "--labels", "coarse.txt"]
    _, out, err = agglo("quality", "in.vtu", *both, "--json")
    levels = json.loads(out)["levels"]
    assert [(level["level"], level["parts"], level["max_cells"]) for level in levels] == [
        ("fine.part.8", 8, 2),
        ("coarse.txt", 2, 8),
    ]
    assert levels[0]["CR"] == pytest.approx(0.2**0.5)
    assert "note: coarse.txt: 2 of the parts 0 to 5 have cells" in err
    assert "coarse.txt" in agglo("quality", "in.vtu", *both).out


@pytest.mark.parametrize(
    ("text", "says"),
    [
        ("0\n" * 15, "15 labels, expected one for each of 16 cells"),
        ("0\n" * 9 + "0.5\n" + "0\n" * 6, "line 10: expected a whole number, found '0.5'"),
        ("0\n" * 9 + "-1\n" + "0\n" * 6, "line 10: vertex 9 is in part -1, expected 0 or more"),
        ("0 1\n" * 8, "line 1: expected 1 numbers, found 2"),
        ("0\n" * 15 + "1", "line 16: the last line has no line break"),
        ("", "0 labels, expected one for each of 16 cells"),
    ],
)
def test_texts_that_are_no_labels_are_refused(agglo: Agglo, text: str, says: str) -> None:
    agglo("mesh", "squares:n=4", "-o", "in.vtu")
    Path("in.txt").write_text(text)
    code, _, err = agglo("quality", "in.vtu", "--labels", "in.txt")
    assert code == 2
    assert f"in.txt: {says}" in " ".join(err.split())


def test_a_component_that_lacks_a_package_says_so_once(agglo: Agglo) -> None:
    needy = Component("bisector", "needy", "nowhere:Needy", requires=("no_such_thing",))
    default_registry().register(SimpleNamespace(agglo_components=hookimpl(lambda: [needy])), "mine")
    try:
        for command in (["run", "squares:n=2", "--bisector", "needy"], ["check", "needy"]):
            code, _, err = agglo(*command)
            assert code == 2
            assert "cannot be used: needs no_such_thing, not installed here" in err
    finally:
        default_registry().unregister("mine")


def test_levels_that_are_none_are_noted(agglo: Agglo) -> None:
    mesh = samples.squares(2)
    write("in.vtu", replace(mesh, cell_tags={"level_1": np.zeros(4, int)}))
    code, out, err = agglo("quality", "in.vtu", "--json")
    assert (code, json.loads(out)["levels"][0]["level"]) == (0, "cells")
    assert "warning: level_1 not read as levels: there is no level_0" in err
    content = Path("in.vtu").read_bytes()
    real = b'<CellData><DataArray type="Float64" Name="level_0" format="ascii">0 0 1 1</DataArray>'
    Path("in.vtu").write_bytes(content.replace(b"<CellData>", real))
    assert "note: cell data that are not integers left out: level_0" in agglo("quality", "in.vtu").err


def test_warnings_are_called_so(agglo: Agglo) -> None:
    """Two cells on one side of an edge; the repair itself is a note."""
    Path("in.off").write_text("OFF\n4 2 0\n0 0 0\n1 0 0\n0 1 0\n1 1 0\n3 0 1 2\n3 0 1 3\n")
    err = " ".join(agglo("quality", "in.off").err.split())
    assert "note: overlapping edges left apart: 1" in err
    assert "warning: 1 pairs of cells overlap at an edge, such as cells 0 and 1: their common area" in err


def test_runs_are_warmed_up_before_the_clock(agglo: Agglo, monkeypatch: pytest.MonkeyPatch) -> None:
    sizes, real = [], one_call.agglomerate

    def recorded(mesh: Mesh, **arguments: Any) -> Hierarchy:
        sizes.append((mesh.n_cells, "kmeans" in str(arguments["bisector"])))
        return real(mesh, **arguments)

    monkeypatch.setattr(one_call, "agglomerate", recorded)
    two = ["--bisector", "kmeans", "--bisector", "inertial"]
    assert agglo("run", "squares:n=3", *two, "--parts", "2", "--quiet").code == 0
    assert sizes == [(16, True), (9, True), (16, False), (9, False)]


def test_a_level_of_one_part_is_noted(agglo: Agglo) -> None:
    err = " ".join(agglo("run", "strip:5").err.split())
    assert err == "note: numbers of parts by level: 1; level 0 has one part. n_parts=… sets them"
    assert agglo("run", "strip:12").err == ""
    assert agglo("run", "strip:5", "--quiet") == (0, "", "")


def test_components_can_be_chosen_and_switched_off(agglo: Agglo) -> None:
    off = agglo(
        "run", "squares:n=4", "--parts", "4", "--refiner", "none", "--fixer", "connectivity", "--json"
    )
    assert off.code == 0
    Path("run.toml").write_text('seed = 3\nn_parts = [2]\n[bisector]\nname = "coordinate"\n')
    code, out, _ = agglo("run", "squares:n=4", "--config", "run.toml", "--json")
    assert code == 0
    assert json.loads(out)["runs"][0]["levels"][0]["parts"] == 2


WRONG: dict[str, tuple[list[str], str]] = {
    "no such file": (["run", "absent.vtu"], "neither an existing file"),
    "no such sample": (["run", "sqares"], "neither an existing file nor a sample"),
    "wrong option of a sample": (["run", "squares:m=3"], "squares"),
    "a folder": (["run", "folder"], "folder"),
    "an empty file": (["run", "empty.vtu"], "empty.vtu"),
    "not a mesh": (["run", "text.vtu"], "text.vtu"),
    "two targets": (["run", "squares:n=4", "--parts", "2", "--h-star", "1"], "--h-star and --parts"),
    "letters for numbers": (
        ["run", "squares:n=4", "--parts", "2,x"],
        "comma-separated list of whole numbers",
    ),
    "a fraction of a part": (
        ["run", "squares:n=4", "--parts", "2.5"],
        "comma-separated list of whole numbers",
    ),
    "more parts than cells": (["run", "squares:n=2", "--parts", "5"], "5"),
    "no parts": (["run", "squares:n=2", "--parts", "4,0"], "'--parts': each number must be positive"),
    "less than a cell": (["run", "squares:n=2", "--cells-per-part", "0.5"], "'--cells-per-part'"),
    "no name": (["run", ""], "the mesh name is empty"),
    "none and a refiner": (
        ["run", "squares:n=4", *["--refiner", "none", "--refiner", "interface"]],
        "--refiner",
    ),
    "letters for a floor": (
        ["run", "squares:n=4", "--refiner", "interface:floor=abc"],
        "floor of refiner 'interface'",
    ),
    "a negative size": (["run", "squares:n=2", "--h-star", "-1"], "-1"),
    "a size that is no number": (["run", "squares:n=2", "--h-star", "nan"], "nan"),
    "an unknown bisector": (["run", "squares:n=4", "--bisector", "kmean"], "did you mean 'kmeans'?"),
    "an unknown option": (["run", "squares:n=4", "--bisector", "kmeans:no_such=1"], "no option 'no_such'"),
    "half an option": (["run", "squares:n=4", "--bisector", "kmeans:axes"], "not of the form option=value"),
    "one bisector twice": (["run", "squares:n=4", *["--bisector", "kmeans"] * 2], "given twice"),
    "an unknown refiner": (["run", "squares:n=4", "--refiner", "nope"], "no refiner is named 'nope'"),
    "an unknown fixer": (["run", "squares:n=4", "--fixer", "nope"], "no fixer is named 'nope'"),
    "an unknown method": (["run", "squares:n=4", "--method", "direct"], "recursive"),
    "no such config": (["run", "squares:n=4", "--config", "absent.toml"], "absent.toml"),
    "an unknown suffix": (["run", "squares:n=4", "-o", "out.xyzzy"], "xyzzy"),
    "a folder as output": (["run", "squares:n=4", "-o", "folder"], "folder: is a folder"),
    "a folder as mesh to write": (["mesh", "squares:n=4", "-o", "folder"], "folder: is a folder"),
    "a folder as picture": (["run", "squares:n=4", "--plot", "folder"], "folder is a folder"),
    "no folder for output": (["run", "squares:n=4", "-o", "absent/out.vtu"], "absent"),
    "not a picture": (["run", "squares:n=4", "--plot", "out.doc"], ".png"),
    "no folder for the picture": (["run", "squares:n=4", "--plot", "absent/out.png"], "absent"),
    "quality of nothing": (["quality", "absent.vtu"], "absent.vtu"),
    "quality of a folder": (["quality", "folder"], "folder"),
    "an unknown suffix for a mesh": (["mesh", "squares:n=4", "-o", "out.xyzzy"], "xyzzy"),
    "an unknown sample for a mesh": (["mesh", "sqares:n=4", "-o", "out.vtu"], "sqares"),
    "an unknown flag": (["run", "squares:n=4", "--no-such-flag"], "--no-such-flag"),
    "nothing to run": (["run"], "Missing argument"),
}


@pytest.mark.parametrize(("arguments", "message"), WRONG.values(), ids=WRONG.keys())
def test_bad_input_is_one_line_and_leaves_nothing(
    agglo: Agglo, tmp_path: Path, arguments: list[str], message: str
) -> None:
    (tmp_path / "folder").mkdir()
    (tmp_path / "empty.vtu").touch()
    (tmp_path / "text.vtu").write_text("not a mesh")
    before = sorted(tmp_path.rglob("*"))
    if arguments[0] == "run" and "-o" not in arguments:
        arguments = [*arguments, "-o", "left.vtu"]
    code, out, err = agglo(*arguments)
    assert (code, out) == (2, "")
    errors = [line for line in err.splitlines() if not line.startswith(("note: ", "warning: ", "usage: "))]
    assert len(errors) == 1
    assert errors[0].startswith("error: ")
    assert message in errors[0]
    assert sorted(tmp_path.rglob("*")) == before


def test_every_file_of_several_runs_has_its_own_name(agglo: Agglo) -> None:
    clash: list[Any] = ["--bisector", "a:n=1", "--bisector", "a:n_1", "-o", "out.vtu"]
    code, _, err = agglo("run", "squares:n=4", *clash)
    assert code == 2
    assert "files with equal names" in err


def test_an_option_with_one_value_is_given_once(agglo: Agglo) -> None:
    done = agglo("run", "squares:n=4", "-o", "a.npz", "--parts", "4", "--output", "b.npz")
    assert done.code == 2
    assert "-o is given twice, but has one value" in done.err
    assert list(Path().iterdir()) == []
    assert agglo("run", "squares:n=4", "--bisector", "kmeans", "--bisector", "sweep", "--quiet").code == 0


def test_an_openfoam_case_holds_the_levels_of_one_bisector(agglo: Agglo) -> None:
    done = agglo("run", "boxes:n=2", "--parts", "2", "--bisector", "kmeans,sweep", "-o", "c.foam")
    assert done.code == 2
    assert "c.foam: a case holds the levels of one bisector, given kmeans and sweep" in done.err
    assert list(Path().iterdir()) == []
