"""What commands, ours and those of plugins, understand of what is typed."""

from __future__ import annotations

import subprocess
import sys
from pathlib import Path
from typing import Any

import click
import pytest

from agglo_core import FileError, OptionError, PluginError, agglomerate, samples, write
from agglo_core.cli.options.agglomeration import agglomeration_options
from agglo_core.cli.options.shared import metrics_option
from agglo_core.cli.options.specs import all_bisectors, choice, load_mesh, refuse_duplicates
from agglo_core.registry.option_types import parse_value


@click.command()
@click.argument("source")
@agglomeration_options
@click.option("--twice", is_flag=True)
def mine(source: str, agglomeration: dict[str, Any], twice: bool) -> dict[str, Any]:
    """A command as a plugin might have it."""
    return agglomeration


def given(*arguments: str) -> dict[str, Any]:
    found: dict[str, Any] = mine.main(["squares:n=4", *arguments], standalone_mode=False)
    return found


def test_what_is_not_given_is_left_to_agglomerate() -> None:
    assert given() == {}
    assert given("--twice", "--seed", "0") == {"seed": 0}


def test_what_is_given_are_arguments_of_agglomerate() -> None:
    found = given("--refiner", "interface", "--fixer", "connectivity", "--parts", "8,2", "--seed", "3")
    assert found == {
        "refiners": (("interface", {}),),
        "fixer": ("connectivity", {}),
        "n_parts": (8, 2),
        "seed": 3,
    }
    assert agglomerate(samples.squares(4), **found).parts == [8, 2]
    assert given("--refiner", "none", "--h-factor", "2,4.5") == {"refiners": (), "h_factor": (2.0, 4.5)}


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        (["--parts", "4", "--cells-per-part", "4"], "--parts and --cells-per-part cannot be combined"),
        (["--refiner", "none", "--refiner", "interface"], "--refiner none cannot be combined with another"),
        (["--parts", "2.5"], "'2.5' is not a comma-separated list of whole numbers"),
        (["--h-star", "1,inf"], "each number must be positive and finite, given inf"),
        (["--cells-per-part", "0.5"], "each number must be at least 1 and finite, given 0.5"),
        (["--seed", "-1"], "-1 is not in the range"),
    ],
)
def test_usage_errors_name_the_options(arguments: list[str], message: str) -> None:
    with pytest.raises(click.UsageError, match=message):
        given(*arguments)


def test_components_that_cannot_be_used_are_refused_before_a_mesh_is_read() -> None:
    for arguments in (["--refiner", "nosuch"], ["--fixer", "nosuch"]):
        with pytest.raises(PluginError, match="nosuch"):
            given(*arguments)
    with pytest.raises(OptionError, match="'ufactor' in 'metis:ufactor' is not of the form"):
        choice("bisector", "metis:ufactor")


def test_values_read_as_what_they_look_like() -> None:
    texts = ("3", "-2.5", "1e-3", "True", "none", "fast")
    assert [parse_value(text) for text in texts] == [3, -2.5, 1e-3, True, None, "fast"]


def test_duplicates_are_refused() -> None:
    refuse_duplicates("--bisector", ["kmeans", "metis"])
    with pytest.raises(click.UsageError, match="--bisector kmeans is given twice"):
        refuse_duplicates("--bisector", ["kmeans", "metis", "kmeans"])


def test_a_mesh_is_a_file_or_a_sample(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.chdir(tmp_path)
    assert load_mesh("squares:n=3").n_cells == 9
    write("squares.npz", samples.squares(2))
    assert load_mesh("squares.npz").n_cells == 4
    with pytest.raises(FileError, match="mesh name is empty"):
        load_mesh("")
    with pytest.raises(FileError, match=r"'no/such\.vtu' is neither an existing file"):
        load_mesh("no/such.vtu")
    with pytest.raises(OptionError, match=r"'sqares' is neither an existing file nor a sample: "):
        load_mesh("sqares")


def test_importing_it_loads_nothing_heavy() -> None:
    loaded = "print([m for m in ('numpy', 'numba', 'rich') if m in sys.modules])"
    source = f"import sys, agglo_core.cli.options.agglomeration; {loaded}"
    answer = subprocess.run([sys.executable, "-c", source], capture_output=True, text=True, check=True)
    assert answer.stdout.strip() == "[]"


@click.command()
@click.option("--bisector", help="In words of its own.")
@agglomeration_options
@click.option("--method")
def older(bisector: str, method: str, agglomeration: dict[str, Any]) -> object:
    """A command that chooses bisector and method by options of its own."""
    return bisector, method, agglomeration


@click.command()
@agglomeration_options(bisector="one")
def one(agglomeration: dict[str, Any]) -> dict[str, Any]:
    """A command that takes one bisector."""
    return agglomeration


@click.command()
@agglomeration_options(bisector="several", method="several")
@metrics_option
def several(agglomeration: dict[str, Any], **rest: Any) -> object:
    """A command that takes several bisectors and methods."""
    return agglomeration, rest


def test_a_command_with_a_bisector_of_its_own_keeps_it() -> None:
    done = older.main(["--bisector", "x", "--method", "y", "--seed", "1"], standalone_mode=False)
    assert done == ("x", "y", {"seed": 1})


def test_one_bisector_and_all_else_are_arguments_of_agglomerate() -> None:
    words = (
        "--bisector kmeans:iterations=9 --method kway --not-nested --refiner none --merge "
        "--post-refiner interface --h-star 1 --config run.toml"
    )
    found = one.main(words.split(), standalone_mode=False)
    assert found == {
        "bisector": ("kmeans", {"iterations": 9}),
        "method": "kway",
        "nested": False,
        "refiners": (),
        "merge": True,
        "post_refiners": (("interface", {}),),
        "h_star": (1.0,),
        "config": Path("run.toml"),
    }
    assert one.main([], standalone_mode=False) == {}
    for wrong in ("--post-refiner none --post-refiner interface", "--method direct"):
        with pytest.raises(click.UsageError):
            one.main(wrong.split(), standalone_mode=False)
    with pytest.raises(PluginError, match="no constraint is named 'nosuch'"):
        one.main(["--constraint", "nosuch"], standalone_mode=False)


def test_several_are_comma_lists_and_repeatable() -> None:
    words = ["--bisector", "kmeans,metis:ufactor=30,contig=true", "--bisector", "inertial"]
    given, rest = several.main([*words, "--method", "kway, recursive", "--seed", "2"], standalone_mode=False)
    assert given == {"seed": 2}
    assert rest == {
        "bisectors": ["kmeans", "metis:ufactor=30,contig=true", "inertial"],
        "methods": ["kway", "recursive"],
        "metrics": None,
    }
    _, rest = several.main(["--bisector", "sweep,all"], standalone_mode=False)
    assert rest["bisectors"] == ["sweep", *(name for name in all_bisectors() if name != "sweep")]
    assert "coordinate" in rest["bisectors"]
    with pytest.raises(click.UsageError, match="--bisector kmeans is given twice"):
        several.main(["--bisector", "kmeans,inertial", "--bisector", "kmeans"], standalone_mode=False)


def test_metrics_and_objectives_are_refused_before_a_mesh_is_read() -> None:
    _, rest = several.main(["--metrics", "UF,diameter_ratio:h_star=2,balance"], standalone_mode=False)
    assert rest["metrics"] == ["UF", ("diameter_ratio", {"h_star": "2"}), "balance"]
    for text, message in {
        "UF,compactnes": "did you mean 'compactness'",
        "diameter_ratio": "needs a value for h_star",
        "diameter_ratio:h_sta=2": "did you mean 'h_star'",
        "UF,UF": "given twice",
    }.items():
        with pytest.raises((OptionError, PluginError), match=message):
            several.main(["--metrics", text], standalone_mode=False)
