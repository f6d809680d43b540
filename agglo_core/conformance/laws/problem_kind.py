"""Laws for a problem kind: name, construction from tables, example, and immutability."""

from __future__ import annotations

import copy
from dataclasses import fields, is_dataclass
from pathlib import Path
from typing import Any

from agglo_core.conformance.base import Broken, Case, Subject, in_words, law, require
from agglo_core.conformance.inputs.questions import answer, digest, questions, same
from agglo_core.conformance.inputs.strategies import mesh_cases
from agglo_core.errors import AggloError
from agglo_core.problems import solve
from agglo_core.registry.containment import PLUGIN_FAILURES
from agglo_core.samples import boxes, squares

_UNKNOWN_KEY = "no_such_key"


def _class_of(tool: Any) -> type:
    return tool if isinstance(tool, type) else type(tool)


@law("problem")
def kind_named(subject: Subject) -> None:
    """The attribute ``kind`` is a name, and for a class of problems equals the declared name."""
    kind = getattr(subject.build(), "kind", None)
    require(
        isinstance(kind, str) and kind.isidentifier(),
        f"attribute kind is {kind!r}, expected its declared name, for instance kind: ClassVar[str] = 'mine'",
    )
    require(
        subject.record is None or subject.takes_options or kind == subject.name,
        f"kind is {kind!r}, but it is declared as {subject.name!r}: use the same name",
    )


@law("problem", draw=mesh_cases, examples=30)
def example_given(subject: Subject, case: Case) -> None:
    """``example(mesh)`` returns a problem of its own class, which is immutable, on every mesh."""
    tool = subject.build()
    example = answer(subject, case, tool)
    require(
        isinstance(example, _class_of(tool)),
        f"example returned {in_words(example)}, expected a {_class_of(tool).__name__}",
    )
    for name in _fields_of(example) or ["no_such_attribute"]:
        try:
            setattr(example, name, getattr(example, name, None))
        except PLUGIN_FAILURES:
            continue
        raise Broken(f"its attribute {name} can be set: make it a @dataclass(frozen=True)")


def _fields_of(example: Any) -> list[str]:
    """Return the fields of dataclasses and named tuples, or the attributes of other objects."""
    names = [f.name for f in fields(example)] if is_dataclass(example) else []
    return names or list(getattr(example, "_fields", ())) or list(getattr(example, "__dict__", {}))


@law("problem")
def table_read(subject: Subject) -> None:
    """``from_table`` names unknown or missing keys in an AggloError, and changes no table or default."""
    (mesh,) = questions(subject)[0].given
    tool = subject.build()
    for table in ({_UNKNOWN_KEY: 1.0}, {}, {"kind": "x", _UNKNOWN_KEY: {"1": 0.0}}):
        given = copy.deepcopy(table)
        try:
            result = tool.from_table(given, mesh, Path())
        except PLUGIN_FAILURES as error:
            result = error
        require(given == table, f"the table {table} became {given}: work on a copy (dict(table))")
        if table == {_UNKNOWN_KEY: 1.0}:
            require(
                isinstance(result, AggloError) and _UNKNOWN_KEY in str(result),
                f"a table with the key {_UNKNOWN_KEY!r} gave {in_words(result)}: raise an OptionError that "
                "names the key and lists those accepted, so that a misspelt one is noticed",
            )
        require(
            isinstance(result, AggloError | _class_of(tool)),
            f"the table {table} gave {in_words(result)}: give each key a default, or name the missing one "
            "in an OptionError",
        )
    # Names of fields in other letters are other keys.
    plain = _read(tool, {}, mesh)
    for name in _numbers_in(tool.example(mesh)):
        misspelt = _read(tool, {name.swapcase(): 7.0}, mesh)
        require(
            not same(misspelt, plain) or same(plain, digest(None)),
            f"the table {{{name.swapcase()!r}: 7.0}} is accepted and ignored: compare keys as they are "
            "written",
        )
    # Tables with one value of the example each, in two rounds.
    tables = [{}, *({name: value} for name, value in _numbers_in(tool.example(mesh)).items())]
    first, again = ([_read(tool, table, mesh) for table in tables] for _ in range(2))
    for table, one, other in zip(tables, first, again, strict=True):
        require(
            same(one, other),
            f"the table {table} gives another problem after {tables}: change no default in the class or the "
            "module, but a copy (dict(defaults))",
        )


@law("problem")
def exact_solution_holds(subject: Subject) -> None:
    """On finer squares and boxes the discrete solution comes closer to the ``exact`` one, if there is any."""
    tool: Any = subject.build()
    by_mesh = isinstance(tool, type)  # else a factory made the problem
    for coarse, fine in ((squares(6), squares(12)), (boxes(4), boxes(8))):
        problems = [tool.example(mesh) if by_mesh else tool for mesh in (coarse, fine)]
        if any(getattr(problem, "exact", None) is None for problem in problems):
            return
        try:
            before, after = (
                solve(mesh, problem, "direct", degree=2).errors()
                for mesh, problem in zip((coarse, fine), problems, strict=True)
            )
        except AggloError:
            continue  # no discretisation, or another domain
        for norm in before:
            require(
                after[norm] <= max(0.6 * before[norm], 1e-9),
                f"the error {norm} is {before[norm]:.3g} on {coarse.name} and {after[norm]:.3g} on "
                f"{fine.name}: exact does not solve the problem in {fine.dim}-D; derive its source for this "
                "dimension",
            )


def _numbers_in(example: Any) -> dict[str, Any]:
    """Return the fields of a problem that are numbers, texts or booleans, as in a file."""
    pairs = {name: getattr(example, name) for name in _fields_of(example)}
    return {name: value for name, value in pairs.items() if isinstance(value, bool | int | float | str)}


def _read(tool: Any, table: dict[str, Any], mesh: Any) -> Any:
    """Read a problem from a table, and return its hash, which is that of None if the table is refused."""
    try:
        return digest(tool.from_table(dict(table), mesh, Path()))
    except PLUGIN_FAILURES:
        return digest(None)
