"""What is refused: the message says what was given, what was expected, and where; nothing is left behind."""

from __future__ import annotations

import json
import logging
from pathlib import Path

import numpy as np
import pytest
from command_line import Agglo

import agglo_core as agglo_
from agglo_core.agglomeration import Pipeline
from agglo_core.errors import AggloError, FileError, MeshError, OptionError, PluginError
from agglo_core.graph import Graph
from agglo_core.problems import named_problem
from agglo_core.registry.attribution import attributed
from agglo_core.registry.toml_files import read_toml

DEEP = 5000

TOML: dict[str, tuple[bytes, str]] = {
    "lists in lists": (b"h_star = " + b"[" * DEEP + b"]" * DEEP, "its lists or tables are nested too deeply"),
    "tables in tables": (b"a = " + b"{a=" * DEEP, "its lists or tables are nested too deeply"),
    "not UTF-8": (b"seed = 1\nbisector = '\xff'\n", "byte 0xff in line 2 is not UTF-8"),
    "not TOML": (b"seed = = 1\n", "is not valid TOML: Invalid value (at line 1"),
    "too many digits": (b"seed = " + b"9" * 5000, "a number has too many digits"),
    "a seed that is no integer": (b"seed = 1.5", "seed must be an integer in 0..2^63 − 1, given 1.5"),
    "a large seed": (b"seed = " + b"9" * 30, "seed must be an integer in 0..2^63 − 1, given 999"),
    "a size that is no number": (b'h_star = "big"', "h_star must be positive and finite, given 'big'"),
    "a size that is a table": (b"h_star = {a = 1}", "h_star must be positive and finite, given {'a': 1}"),
    "NaN": (b"h_star = [1, nan]", "h_star must be positive and finite, given nan"),
    "infinity": (b"h_factor = inf", "h_factor must be positive and finite, given inf"),
    "beyond all floats": (b"n_parts = " + b"9" * 400, "n_parts must be positive and finite, given 999"),
    "true": (b"n_parts = true", "n_parts must be positive and finite, given True"),
    "half a part": (b"n_parts = 2.5", "n_parts must be a whole number, given 2.5"),
    "less than a cell": (b"cells_per_part = 0.25", "cells_per_part must be at least 1, given 0.25"),
    "nothing": (b"h_star = []", "h_star is empty: give at least one value"),
    "two targets": (b"h_star = 1\nn_parts = 2", "give one kind of target, not h_star and n_parts"),
    "a word for a truth": (b'nested = "yes"', "nested must be true or false, given 'yes'"),
    "a word for a list": (b'refiners = "interface"', "refiners must be a list, given 'interface'"),
    "a number for a name": (b"bisector = 3", "bisector must be a name or a table with a name, given 3"),
    "an unknown key": (b"h_stra = 1", "unknown key 'h_stra' (did you mean 'h_star'?); accepted: bisector, "),
}


@pytest.mark.parametrize(("content", "message"), TOML.values(), ids=TOML.keys())
def test_files_of_runs(agglo: Agglo, tmp_path: Path, content: bytes, message: str) -> None:
    (tmp_path / "run.toml").write_bytes(content)
    code, out, err = agglo("run", "squares:n=4", "--config", "run.toml", "-o", "left.vtu", "--quiet")
    assert (code, out) == (2, "")
    assert err.startswith(f"error: run.toml: {message}")
    assert (err.count("\n"), len(err) < 420) == (1, True)
    assert [file.name for file in tmp_path.iterdir()] == ["run.toml"]
    with pytest.raises((FileError, OptionError), match=r"^run\.toml: "):
        Pipeline.from_toml("run.toml")


def test_files_that_are_none(agglo: Agglo, tmp_path: Path) -> None:
    (tmp_path / "folder").mkdir()
    ask = ["run", "squares:n=4", "--config"]
    assert agglo(*ask, "no.toml").err == "error: no.toml: no such file; expected a TOML file\n"
    assert agglo(*ask, "folder").err == "error: folder: is a folder; expected a TOML file\n"
    assert agglo(*ask, "").err.startswith("error: Invalid value for '--config': the file name is empty\n")
    problem = agglo("solve", "squares:n=4", "--problem", "no.toml")
    assert "no.toml: no such file, and no problem of that name (constant," in problem.err


def test_files_that_may_not_be_read(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    def forbidden(self: Path, **_: str) -> str:
        raise PermissionError(13, "Permission denied")

    monkeypatch.setattr(Path, "read_text", forbidden)
    (tmp_path / "mine.toml").touch()
    with pytest.raises(FileError, match=r"mine\.toml: cannot be read: Permission denied$"):
        read_toml(tmp_path / "mine.toml")


def test_a_byte_order_mark_is_no_error(tmp_path: Path) -> None:
    (tmp_path / "run.toml").write_bytes(b"\xef\xbb\xbfn_parts = [4, 2]\n")
    assert Pipeline.from_toml(tmp_path / "run.toml").n_parts == [4, 2]


def test_deep_files_of_problems(tmp_path: Path) -> None:
    (tmp_path / "deep.toml").write_text("kappa = " + "[" * DEEP)
    with pytest.raises(FileError, match="nested too deeply"):
        named_problem(str(tmp_path / "deep.toml"), agglo_.samples.squares(2))


def test_deep_headers_of_models(agglo: Agglo) -> None:
    header = b'{"__metadata__": ' + b"[" * 10**5
    Path("deep.safetensors").write_bytes(len(header).to_bytes(8, "little") + header)
    code, _, err = agglo("model", "info", "deep.safetensors")
    assert (code, err.count("\n")) == (2, 1)
    assert "deep.safetensors: has no header of an agglo model" in err


ANYWHERE: dict[str, tuple[list[str], str]] = {
    "a fraction": (["--seed", "1.5"], "'1.5' is not a valid integer; expected a whole number of at least 0"),
    "a word": (["--seed", "one"], "'one' is not a valid integer"),
    "below the range": (["--seed", "-1"], "-1 is not in the range; expected a whole number of at least 0"),
    "many digits": (["--parts", "9" * 5000], "999…' is not a comma-separated list of whole numbers"),
    "beyond all floats": (["--parts", "9" * 400], "n_parts must be positive and finite, given 999"),
    "beyond all arrays": (["--parts", "9" * 30], "too many parts, 1e+30: the mesh has 16 cells"),
    "an empty list": (["--h-star", ""], "'' is not a comma-separated list of numbers"),
    "an empty output": (["-o", ""], "the file name is empty"),
    "an empty picture": (["--plot", ""], "the file name is empty"),
    "an empty bisector": (["--bisector", ""], "'' has no name; expected NAME or NAME:option=value,…"),
}


@pytest.mark.parametrize(("arguments", "message"), ANYWHERE.values(), ids=ANYWHERE.keys())
def test_options(agglo: Agglo, tmp_path: Path, arguments: list[str], message: str) -> None:
    code, out, err = agglo("run", "squares:n=4", *arguments, "--quiet")
    assert (code, out) == (2, "")
    assert message in err
    assert len(err) < 300
    assert not list(tmp_path.iterdir())


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        (["demo", "--diameter-fraction", "nan"], "nan is not in the range; expected a finite number above"),
        (["demo", "--diameter-fraction", "x"], "'x' is not a valid float; expected a finite number above 0"),
        (["solve", "squares:n=4", "--tol", "nan"], "tolerance must be a number between 0 and 1; given nan"),
        (["solve", "squares:n=4", "--levels", "1e3"], "'1e3' is not a valid integer; expected a whole"),
        (["solve", "squares:n=4", "--problem", ""], "--problem is empty; expected a problem name"),
        (["train", "--epochs", "1.5"], "'1.5' is not a valid integer; expected a whole number of at least 1"),
        (["train", "--pieces", "nan"], "expected a finite number of at least 0 and at most 1"),
        (["train", "--seed", str(2**31)], "of at least 0 and at most 2147483647"),
        (["quality", ""], "the file name is empty"),
        (["model", "info", "none.safetensors"], "none.safetensors: cannot be read: No such file"),
        (["run", "squares:n=0"], "error: n of sample squares must be a whole number >= 1, not 0"),
        (["run", "squares:n=99999"], "error: n of sample squares must be at most 46340, not 99999"),
        (["run", "boxes:n=" + "9" * 30], "error: n of sample boxes must be at most 1290, not 999"),
        (["run", "voronoi:n=1e3"], "must be a whole number, given 1000.0"),
    ],
)
def test_numbers_of_other_commands(agglo: Agglo, tmp_path: Path, arguments: list[str], message: str) -> None:
    code, out, err = agglo(*arguments)
    assert (code, out) == (2, "")
    lines = err.splitlines()
    assert message in lines[0]
    assert len(lines) == 1 + lines[0].startswith("error: Invalid value")  # and the usage
    assert not list(tmp_path.iterdir())


def test_targets_beyond_all_floats() -> None:
    with pytest.raises(OptionError, match="h_star must be positive and finite, given 1000"):
        agglo_.agglomerate(agglo_.samples.squares(2), h_star=10**400)


class Says:
    """A bisector that raises what it was given."""

    def __init__(self, error: Exception) -> None:
        self.error = error

    def bisect(self, graph: Graph, rng: np.random.Generator) -> np.ndarray:
        raise self.error


class TheirError(OptionError):
    """An error of a stranger's own, made in another way."""

    def __init__(self, option: str, given: int) -> None:
        super().__init__(f"{option} cannot be {given}")


@pytest.mark.parametrize(
    ("error", "family"),
    [
        (OptionError("only planes"), OptionError),
        (MeshError("cell 3 is flat"), MeshError),
        (FileError("weights.bin: is empty"), FileError),
        (PluginError("I am broken"), PluginError),
        (AggloError("something"), AggloError),
        (TheirError("depth", 3), OptionError),
    ],
)
def test_agglo_errors_of_components_keep_their_type(error: AggloError, family: type[AggloError]) -> None:
    with pytest.raises(AggloError) as caught:
        agglo_.agglomerate(agglo_.samples.squares(2), bisector=Says(error), n_parts=2)
    assert type(caught.value) is family
    assert str(caught.value) == f"bisector Says: {error}"
    assert caught.value.__cause__ is error


def test_other_exceptions_of_components_are_plugin_errors() -> None:
    with pytest.raises(PluginError, match=r"^mine raised ZeroDivisionError"), attributed("mine"):
        raise ZeroDivisionError


def test_what_is_for_planes_refuses_solids(agglo: Agglo) -> None:
    code, out, err = agglo(
        "run", "boxes:n=2", "--bisector", "gnn:lookahead=2", "--h-star", "0.9", "-o", "left.vtu"
    )
    assert (code, out, Path("left.vtu").exists()) == (2, "", False)
    assert "error: bisector 'gnn' (plugin 'gnn', distribution agglo" in err
    assert "raised" not in err
    with pytest.raises(OptionError, match="3"):
        agglo_.agglomerate(agglo_.samples.boxes(2), bisector=("gnn", {"lookahead": 2}), h_star=0.9)


LARGE = "larger than h*"


@pytest.mark.parametrize(
    "how",
    [
        {"h_star": (0.2, 0.25, 0.3)},
        {"h_star": (0.2, 0.25), "nested": False},
        {"h_star": (0.2, 0.25), "merge": True, "post_refiners": ("interface",)},
        {"h_star": (0.2, 0.25), "bisector": "kmeans", "method": "kway"},
        {"h_star": (0.2, 0.25), "bisector": "kmeans", "method": "kway", "nested": False},
    ],
)
def test_large_cells_are_spoken_of_once(caplog: pytest.LogCaptureFixture, how: dict[str, object]) -> None:
    arguments = {"bisector": "inertial", **how}
    with caplog.at_level(logging.INFO, "agglo"):
        hierarchy = agglo_.agglomerate(agglo_.samples.squares(4), **arguments)  # type: ignore[arg-type]
    assert hierarchy.statistics["oversized_cells"] == 16
    said = [record.getMessage() for record in caplog.records if LARGE in record.getMessage()]
    assert said == ["16 cells are larger than h* = 0.2; each such cell stays a part"]


def test_a_comparison_speaks_of_them_once(agglo: Agglo) -> None:
    ask = ["squares:n=4", "--h-star", "0.2,0.3", "--bisector", "inertial,coordinate,kmeans"]
    done = agglo("compare", *ask)
    assert (done.code, done.err.count(LARGE)) == (0, 1)
    assert agglo("run", *ask, "--quiet") == (0, "", "")
    assert json.loads(agglo("run", *ask, "--json").out)["runs"][0]["statistics"]["oversized_cells"] == 16
