"""Laws for a problem kind: name, construction from tables, example, and immutability."""

from __future__ import annotations

import copy
from dataclasses import fields, is_dataclass
from pathlib import Path
from typing import Any

from agglo_core.conformance.base.law import law
from agglo_core.conformance.base.subject import Subject
from agglo_core.conformance.base.verdict import Broken, require
from agglo_core.conformance.inputs.mesh_cases import on_meshes
from agglo_core.conformance.inputs.questions import answer, in_words, questions
from agglo_core.errors import AggloError
from agglo_core.registry.containment import PLUGIN_FAILURES

_UNKNOWN_KEY = "no_such_key"


@law("problem")
def kind_named(subject: Subject) -> None:
    """The attribute ``kind`` is a name, and for a class of problems equals the declared name."""
    kind = getattr(subject.build(), "kind", None)
    require(
        isinstance(kind, str) and kind.isidentifier(),
        f"attribute kind is {kind!r}, expected its declared name, for instance kind: ClassVar[str] = 'mine'",
    )
    if subject.record is not None and not subject.takes_options:
        require(
            kind == subject.name,
            f"kind is {kind!r}, but it is declared as {subject.name!r}: use the same name",
        )


@law("problem")
def example_given(subject: Subject) -> None:
    """``example(mesh)`` returns a problem of its own class on every test mesh."""
    tool = subject.build()
    problem_class = tool if isinstance(tool, type) else type(tool)
    for case in questions(subject):
        example = answer(subject, tool, case)
        require(
            isinstance(example, problem_class),
            f"on {case.name}: example returned {in_words(example)}, expected a {problem_class.__name__}",
        )


@law("problem")
def problem_frozen(subject: Subject) -> None:
    """Problems are immutable."""
    case = on_meshes("problem")[0]
    example = answer(subject, subject.build(), case)
    # Fields of dataclasses and named tuples; other classes keep their attributes in a dictionary.
    names = [f.name for f in fields(example)] if is_dataclass(example) else []
    names = names or list(getattr(example, "_fields", ())) or list(getattr(example, "__dict__", {}))
    for name in names or ["no_such_attribute"]:
        try:
            setattr(example, name, getattr(example, name, None))
        except PLUGIN_FAILURES:
            continue
        raise Broken(f"its attribute {name} can be set: make it a @dataclass(frozen=True)")


@law("problem")
def table_checked(subject: Subject) -> None:
    """``from_table`` refuses an unknown key with an AggloError that names the key."""
    error = _from_table(subject, {_UNKNOWN_KEY: 1.0})
    require(
        isinstance(error, AggloError) and _UNKNOWN_KEY in str(error),
        f"a table with the key {_UNKNOWN_KEY!r} gave {in_words(error)}: raise an OptionError that names the "
        "key and lists those accepted, so that a misspelt one is noticed",
    )


@law("problem")
def empty_table_served(subject: Subject) -> None:
    """``from_table`` accepts an empty table or raises an AggloError about the missing key."""
    result = _from_table(subject, {})
    tool = subject.build()
    problem_class = tool if isinstance(tool, type) else type(tool)
    require(
        isinstance(result, AggloError | problem_class),
        f"an empty table gave {in_words(result)}: give each key a default, or name the missing one in an "
        "OptionError",
    )


@law("problem")
def table_left_alone(subject: Subject) -> None:
    """``from_table`` leaves the table unchanged."""
    for table in ({}, {"kind": "x", _UNKNOWN_KEY: {"1": 0.0}}):
        before = copy.deepcopy(table)
        _from_table(subject, table)
        require(table == before, f"the table {before} became {table}: work on a copy (dict(table))")


def _from_table(subject: Subject, table: dict[str, Any]) -> Any:
    """Build a problem from a table, and return the problem or the exception raised."""
    (mesh,) = on_meshes("problem")[0].given
    try:
        return subject.build().from_table(table, mesh, Path())
    except PLUGIN_FAILURES as error:
        return error
