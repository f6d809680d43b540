"""The examples in the docstrings of public names do what they say."""

from __future__ import annotations

import doctest
import inspect
from collections.abc import Iterator
from functools import cached_property
from importlib import import_module
from pathlib import Path
from types import FunctionType
from typing import Any

import pytest
from documented import MODULES, callables

import agglo_core

FLAGS = doctest.NORMALIZE_WHITESPACE | doctest.ELLIPSIS


def texts(value: Any) -> Iterator[str]:
    """Docstrings of a function, or of a class and its own methods and properties."""
    yield inspect.getdoc(value) or ""
    for name, member in vars(value).items() if inspect.isclass(value) else ():
        if name[0] != "_" and isinstance(
            member, FunctionType | classmethod | staticmethod | property | cached_property
        ):
            yield inspect.getdoc(member) or ""


def examples() -> dict[str, doctest.DocTest]:
    """The examples of every public name, each thing once, by its first name."""
    parser, found, seen = doctest.DocTestParser(), {}, set()
    for module in MODULES:
        for name, value in callables(module):
            text = "\n\n".join(texts(value))
            if ">>>" in text and id(value) not in seen:
                names = {**vars(import_module(value.__module__)), "agglo": agglo_core}
                found[f"{module}.{name}"] = parser.get_doctest(text, names, f"{module}.{name}", None, 0)
            seen.add(id(value))
    return found


EXAMPLES = examples()


@pytest.mark.parametrize("name", EXAMPLES)
def test_the_example_does_what_it_says(name: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    if name.startswith("agglo_core.distributed"):
        pytest.importorskip("mpi4py")
    monkeypatch.chdir(tmp_path)
    said: list[str] = []
    doctest.DocTestRunner(optionflags=FLAGS).run(EXAMPLES[name], out=said.append)
    assert not said, "".join(said)


@pytest.mark.parametrize("module", MODULES)
def test_every_public_name_has_an_example(module: str) -> None:
    shown = {name.rpartition(".")[2] for name in EXAMPLES}
    assert {name for name, _ in callables(module)} <= shown
