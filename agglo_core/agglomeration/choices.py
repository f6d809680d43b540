"""What users choose components by, and the components they stand for."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from typing import Any

from agglo_core.agglomeration.run import Member
from agglo_core.errors import AggloError, FileError, OptionError, PluginError
from agglo_core.registry import default, describe

__all__ = ["Choice", "choice_from_table", "fallback_member", "member", "short_name"]

Choice = str | tuple[str, Mapping[str, Any]] | Any
"""A component: its name, its name with options, or an object that has the method of its kind."""


def fallback_member(bisector: Member, name: str | None) -> Member | None:
    if name is None:
        return None
    try:
        return member("bisector", name)[0]
    except AggloError as error:
        raise PluginError(f"{bisector.title} declares the fallback {name!r}: {error}") from error


def choice_from_table(file: Path, key: str, value: Any) -> Choice:
    if isinstance(value, str):
        return value
    if isinstance(value, dict) and isinstance(value.get("name"), str):
        return value["name"], {option: each for option, each in value.items() if option != "name"}
    raise FileError(f"{file}: {key} must be a name or a table with a name, not {value!r}")


def short_name(choice: Choice) -> str:
    if isinstance(choice, str):
        return choice
    return choice[0] if isinstance(choice, tuple) else type(choice).__name__


def _named(kind: str, choice: tuple[Any, ...]) -> tuple[str, Mapping[str, Any]]:
    if len(choice) == 2 and isinstance(choice[0], str) and isinstance(choice[1], Mapping):
        return choice[0], choice[1]
    raise OptionError(f"a {kind} is a name, (name, options) or an object, not {choice!r}")


def member(kind: str, choice: Choice) -> tuple[Member, str | None]:
    """The component a choice stands for, and the name of the fallback it declared."""
    if isinstance(choice, str | tuple):
        name, options = (choice, {}) if isinstance(choice, str) else _named(kind, choice)
        record = default().record(kind, name)
        tool = default().assemble(record, options)
        return Member(tool, describe(record)), record.component.fallback if record.component else None
    methods = {
        "bisector": ("bisect", "bisect_level", "partition"),
        "refiner": ("refine",),
        "fixer": ("fix",),
    }[kind]
    if isinstance(choice, type) or not any(callable(getattr(choice, each, None)) for each in methods):
        raise OptionError(
            f"{choice!r} is no {kind}: it needs a name or an object with {' or '.join(methods)}"
        )
    return Member(choice, f"{kind} {type(choice).__name__}"), getattr(choice, "fallback", None)
