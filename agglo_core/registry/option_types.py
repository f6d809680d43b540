"""Option types: test and conversion of values, and type description in words."""

from __future__ import annotations

import inspect
import types
from enum import Enum
from pathlib import Path
from typing import Annotated, Any, Final, Literal, Union, get_args, get_origin

from agglo_core.registry.code_options import names_code, plain

UNTYPED: Final = inspect.Parameter.empty
"""Annotation of an option without annotation."""

_WORDS = {"true": True, "false": False, "none": None}
_WORDS_OF: dict[Any, str] = {
    bool: "true or false",
    int: "a whole number",
    float: "a number",
    str: "text",
    Path: "a path",
    type(None): "none",
    None: "none",
}


class Text(str):
    """A value typed by the user, not yet converted to its option type."""

    __slots__ = ()


def parse_value(text: str) -> int | float | bool | str | None:
    """Convert a text to an integer, float, boolean or None if it has such a form.

    Otherwise return the text.
    """
    if text.lower() in _WORDS:
        return _WORDS[text.lower()]
    for number in (int, float):
        try:
            return number(text)
        except ValueError:
            continue
    return str(text)


def words_of(annotation: Any) -> list[str]:
    """Return the words that an option of this type accepts, if there are finitely many."""
    members = get_args(annotation) if get_origin(annotation) in (Union, types.UnionType) else (annotation,)
    words: list[str] = []
    for member in members:
        if get_origin(member) is Literal:
            words += [str(choice) for choice in get_args(member)]
        elif isinstance(member, type) and issubclass(member, Enum):
            words += [str(choice.value) for choice in member]
        elif member is bool:
            words += ["true", "false"]
        elif member in (None, type(None)):
            words.append("none")
    return words


def fit(annotation: Any, value: Any) -> tuple[bool, Any]:
    """Test whether a value fits a type annotation, and convert it.

    Unknown annotations accept any value.
    """
    members = _members(annotation)
    if members is None:
        return True, parse_value(value) if isinstance(value, Text) else value
    results = (_fit(member, plain(value)) for member in members)
    return next((result for result in results if result[0]), (False, None))


def _members(annotation: Any) -> tuple[Any, ...] | None:
    """Return the types in a union, text last, or None if one of them is not supported."""
    members = get_args(annotation) if get_origin(annotation) in (Union, types.UnionType) else (annotation,)
    if not all(_is_known(member) for member in members):
        return None
    return tuple(sorted(members, key=lambda member: member in (str, Path)))


def _is_known(member: Any) -> bool:
    if (
        _is_code(member)
        or get_origin(member) is Literal
        or member in (bool, int, float, str, Path, type(None), None)
    ):
        return True
    if get_origin(member) is tuple:
        return all(argument is Ellipsis or _members(argument) is not None for argument in get_args(member))
    return isinstance(member, type) and issubclass(member, Enum)


def _is_code(member: Any) -> bool:
    return get_origin(member) is Annotated and names_code(member)


def _fit(member: Any, value: Any) -> tuple[bool, Any]:
    """Test whether a value fits a single type, and convert it."""
    if _is_code(member):
        return isinstance(value, str), str(value) if isinstance(value, str) else None
    if get_origin(member) is Literal:
        return _fit_literal(get_args(member), value)
    if get_origin(member) is tuple:
        return _fit_tuple(get_args(member), value)
    if isinstance(member, type) and issubclass(member, Enum):
        return _fit_enum(member, value)
    if isinstance(value, Text):
        return _read(member, value)
    if member in (None, type(None)):
        return value is None, None
    if member is Path:
        return isinstance(value, str | Path), Path(value) if isinstance(value, str | Path) else None
    return _is_instance(member, value), value


def _read(member: Any, text: Text) -> tuple[bool, Any]:
    """Convert a text to a basic type: number, boolean, None, text or path."""
    if member is str:
        return True, str(text)
    if member is Path:
        return True, Path(text)
    if member in (bool, None, type(None)):
        values: tuple[Any, ...] = (True, False) if member is bool else (None,)
        word = _WORDS.get(text.lower(), UNTYPED)
        return word in values and word is not UNTYPED, word
    try:
        return True, member(text)
    except ValueError:
        return False, None


def _is_instance(member: type, value: Any) -> bool:
    """Return True if a value is of a basic type: number, boolean or text.

    Numpy numbers are numbers, a bool is not.
    """
    if member is bool:
        return isinstance(value, bool) or type(value).__name__ in ("bool", "bool_")
    if member is str:
        return isinstance(value, str)
    if isinstance(value, bool) or not hasattr(value, "__float__") or getattr(value, "ndim", 0) != 0:
        return False
    return member is float or hasattr(value, "__index__")


def _fit_literal(accepted: tuple[Any, ...], value: Any) -> tuple[bool, Any]:
    for literal in accepted:
        if isinstance(value, Text):
            fits, read = _fit(type(literal), value)
            if fits and read == literal:
                return True, literal
        elif type(value) is type(literal) and value == literal:
            return True, literal
    return False, None


def _fit_enum(member: type[Enum], value: Any) -> tuple[bool, Any]:
    if isinstance(value, member):
        return True, value
    for choice in member:
        if value == choice.name or value == choice.value or str(value) == str(choice.value):
            return True, choice
    return False, None


def _fit_tuple(members: tuple[Any, ...], value: Any) -> tuple[bool, Any]:
    """Convert a list or tuple, each item to its type.

    A text is split at ``+``, because commas separate options.
    """
    if isinstance(value, Text):
        items: list[Any] = [Text(item.strip()) for item in value.split("+")]
    elif isinstance(value, list | tuple):
        items = list(value)
    else:
        return False, None
    kinds = [members[0]] * len(items) if len(members) == 2 and members[1] is Ellipsis else list(members)
    if len(kinds) != len(items):
        return False, None
    results = []
    for kind, item in zip(kinds, items, strict=True):
        candidates = [_fit(element, item) for element in _members(kind) or ()]
        good = [result for fits, result in candidates if fits]
        if not good:
            return False, None
        results.append(good[0])
    return True, tuple(results)


def in_words(annotation: Any) -> str:
    if annotation is UNTYPED:
        return "any"
    if _is_code(annotation):
        return "code to import and run, as module:attribute (in a file only with --allow-code)"
    if get_origin(annotation) in (Union, types.UnionType):
        return " or ".join(in_words(member) for member in get_args(annotation))
    if get_origin(annotation) is Literal:
        return " or ".join(repr(choice) for choice in get_args(annotation))
    if get_origin(annotation) is tuple:
        return f"tuple of {', '.join('…' if m is Ellipsis else in_words(m) for m in get_args(annotation))}"
    if isinstance(annotation, type) and issubclass(annotation, Enum):
        return " or ".join(repr(choice.name) for choice in annotation)
    return _WORDS_OF.get(annotation, str(getattr(annotation, "__name__", annotation)))
