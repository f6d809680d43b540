"""Options of components: types from annotations, the same on the command line, in TOML and in Python."""

from __future__ import annotations

from collections.abc import Callable
from enum import Enum
from functools import partial
from pathlib import Path
from typing import Any, Literal, NamedTuple

import numpy as np
import pytest

import agglo_core as agglo
from agglo_core import Component, OptionError, Pipeline, PluginError, Registry, hookimpl, samples
from agglo_core.registry.option_types import Text, parse_value
from agglo_core.registry.options import Option, convert, options_of


class Colour(Enum):
    """An Enum as an option."""

    RED = "r"
    BLUE = "b"


def many(
    name: str = "x",
    count: int = 1,
    size: float = 1.0,
    on: bool = False,
    mode: Literal["fast", "slow", 3] = "fast",
    colour: Colour = Colour.RED,
    file: Path | None = None,
    pair: tuple[int, float] = (1, 2.0),
    names: tuple[str, ...] = (),
    rule: Callable[[int], int] | str | None = None,
    free=None,
) -> None:
    """Take options of every type.

    Parameters
    ----------
    name : str
        What it is called. Nobody
        reads on.
    count, size : number
        How many and how large; the rest follows
        on the next line.
    """


OPTIONS = {option.name: option for option in options_of(many) or ()}


@pytest.mark.parametrize(
    ("name", "text", "value"),
    [
        ("name", "007", "007"),
        ("name", "true", "true"),
        ("count", "7", 7),
        ("size", "7", 7.0),
        ("size", "1e-3", 1e-3),
        ("on", "True", True),
        ("on", "false", False),
        ("mode", "slow", "slow"),
        ("mode", "3", 3),
        ("colour", "BLUE", Colour.BLUE),
        ("colour", "b", Colour.BLUE),
        ("file", "none", None),
        ("file", "a/b.vtu", Path("a/b.vtu")),
        ("pair", "3+4", (3, 4.0)),
        ("names", "a+007+c", ("a", "007", "c")),
        ("rule", "fast", "fast"),
        ("rule", "none", None),
        ("free", "3", 3),
    ],
)
def test_what_is_typed_becomes_what_the_option_takes(name: str, text: str, value: object) -> None:
    found = convert(OPTIONS[name], Text(text), "it")
    assert found == value
    assert type(found) is type(value)


@pytest.mark.parametrize(
    ("name", "value"),
    [
        ("name", "x"),
        ("count", np.int64(3)),
        ("size", 3),
        ("size", np.float32(3)),
        ("on", np.bool_(True)),
        ("mode", 3),
        ("colour", Colour.RED),
        ("file", None),
        ("rule", len),
        ("free", object()),
    ],
)
def test_what_python_gives_is_left_as_it_is(name: str, value: object) -> None:
    assert convert(OPTIONS[name], value, "it") is value


def test_the_default_fits_whatever_the_annotation_says() -> None:
    def older(count: int = None, name: str = None, size: float = "auto") -> None:  # type: ignore[assignment]  # noqa: RUF013
        """Options as many write them."""

    count, name, size = options_of(older) or ()
    assert [convert(option, None, "it") for option in (count, name)] == [None, None]
    assert [convert(option, Text("none"), "it") for option in (count, name)] == [None, None]
    assert convert(count, Text("3"), "it") == 3
    assert convert(size, "auto", "it") == convert(size, Text("auto"), "it") == "auto"
    assert count.type_name == "a whole number or none"
    for option, wrong in ((count, "x"), (count, 2.5), (size, None), (size, "automatic")):
        with pytest.raises(OptionError):
            convert(option, wrong, "it")


def test_lists_and_texts_of_toml_fit() -> None:
    assert convert(OPTIONS["pair"], [3, 4], "it") == (3, 4)
    assert convert(OPTIONS["file"], "a.vtu", "it") == Path("a.vtu")
    assert convert(OPTIONS["colour"], "r", "it") is Colour.RED


@pytest.mark.parametrize(
    ("name", "value", "wanted"),
    [
        ("count", Text("2.5"), "count of it must be a whole number, given 2.5"),
        ("count", 2.5, "count of it must be a whole number, given 2.5"),
        ("count", True, "count of it must be a whole number, given True"),
        ("count", "3", "count of it must be a whole number, given '3'"),
        ("size", Text("abc"), "size of it must be a number, given 'abc'"),
        ("on", Text("1"), "on of it must be true or false, given 1"),
        ("mode", Text("sow"), "mode of it must be 'fast' or 'slow' or 3, given 'sow'"),
        ("mode", "sow", "mode of it must be 'fast' or 'slow' or 3, given 'sow'"),
        ("colour", Text("green"), "colour of it must be 'RED' or 'BLUE', given 'green'"),
        ("pair", Text("3"), "pair of it must be tuple of a whole number, a number, given 3"),
        ("pair", [1, 2, 3], "pair of it must be"),
        ("name", 7, "name of it must be text, given 7"),
    ],
)
def test_what_does_not_fit_is_refused(name: str, value: object, wanted: str) -> None:
    with pytest.raises(OptionError) as caught:
        convert(OPTIONS[name], value, "it")
    assert str(caught.value).startswith(wanted)


def test_texts_without_a_type_read_as_what_they_look_like() -> None:
    texts = ("3", "-2.5", "1e-3", "True", "none", "fast")
    assert [parse_value(text) for text in texts] == [3, -2.5, 1e-3, True, None, "fast"]


def test_docstrings_say_what_options_mean() -> None:
    assert OPTIONS["name"].about == "What it is called"
    assert OPTIONS["size"].about == "How many and how large; the rest follows on the next line"
    assert OPTIONS["mode"].about == ""
    assert not any(option.required for option in OPTIONS.values())


def test_whoever_takes_anything_checks_it_himself() -> None:
    assert options_of(lambda **options: options) is None
    assert options_of(partial(many, name="y")) is not None
    assert options_of(int) is None or isinstance(options_of(int), tuple)


class Named:
    """Splits nothing; takes a name."""

    def __init__(self, name: str, mode: Literal["a", "b"] = "a") -> None:
        self.name, self.mode = name, mode

    def bisect(self, graph: Any, rng: Any) -> Any:
        """Halves."""
        return np.arange(graph.n) * 2 // graph.n


class Declared:
    """A plugin with that component."""

    @hookimpl
    def agglo_components(self) -> list[Component]:
        """One bisector."""
        return [Component("bisector", "named", f"{__name__}:Named")]


@pytest.fixture
def registry(monkeypatch: pytest.MonkeyPatch) -> Registry:
    monkeypatch.setitem(__import__("sys").modules, __name__, __import__("types").SimpleNamespace(Named=Named))
    made = Registry()
    made.register(Declared(), "mine")
    return made


def test_the_registry_builds_by_these_rules(registry: Registry) -> None:
    assert registry.build("bisector", "named", name=Text("007")).name == "007"
    with pytest.raises(OptionError, match="needs a value for name"):
        registry.build("bisector", "named")
    with pytest.raises(OptionError, match=r"mode of bisector 'named' .* must be 'a' or 'b', given 'c'"):
        registry.build("bisector", "named", name="x", mode="c")


def test_toml_and_the_command_line_agree(tmp_path: Path) -> None:
    file = tmp_path / "run.toml"
    file.write_text('n_parts = 4\nbisector = {name = "metis", algorithm = "kwy"}\n')
    with pytest.raises(OptionError, match=r"algorithm of bisector 'metis' .* must be 'kway' or 'recursive'"):
        Pipeline.from_toml(file).run(samples.squares(4))
    with pytest.raises((OptionError, PluginError), match="given '4'"):
        Pipeline(bisector=("kmeans", {"iterations": "4"}), n_parts=4).run(samples.squares(4))


class Rounds(NamedTuple):
    rounds: int = 3


def test_options_of_a_named_tuple_have_their_types() -> None:
    assert [option.type for option in options_of(Rounds) or ()] == [int]


def test_an_empty_container_of_a_dataclass_is_shown_as_default() -> None:
    defaults = {option.name: option.default for option in options_of(agglo.Diffusion) or ()}
    assert (defaults["dirichlet"], defaults["kappa"]) == ({}, 1.0)


def test_the_type_name_of_an_option_is_in_words() -> None:
    assert Option("n", int | None, 1).type_name == "a whole number or none"


class Moody:
    """A format whose attribute cannot be read."""

    suffixes = (".moody",)

    @property
    def lossless(self) -> bool:
        """Never there."""
        raise ValueError("not today")

    def read(self, path: Path) -> None:
        """Nothing."""


def test_an_attribute_that_raises_is_attributed(monkeypatch: pytest.MonkeyPatch) -> None:
    class Plugin:
        @hookimpl
        def agglo_components(self) -> list[Component]:
            return [Component("format", "moody", "moody_module:Moody")]

    module = __import__("types").SimpleNamespace(Moody=Moody)
    monkeypatch.setitem(__import__("sys").modules, "moody_module", module)
    registry = Registry()
    registry.register(Plugin(), "mine")
    with pytest.raises(PluginError, match=r"format 'moody' .* 'lossless' raised ValueError: not today"):
        registry.build("format", "moody")
