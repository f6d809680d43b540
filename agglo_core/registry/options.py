"""Options of components: names, types, and whether a value fits.

An option is a keyword of the constructor; its type is the annotation there, one of bool, int, float, str,
``Literal[…]``, an Enum, Path, a tuple of these, or a union, also with None. The default always fits:
``int = None`` takes None too. The same rules hold on the command line (where every value is a text), in
TOML and in Python. What has another annotation, or none, accepts anything; a text then becomes what it
looks like: a number, true, false, none, or itself.
"""

from __future__ import annotations

import inspect
import re
import types
from collections.abc import Callable
from dataclasses import dataclass
from enum import Enum
from functools import lru_cache
from pathlib import Path
from typing import Any, Literal, Optional, Union, get_args, get_origin

from agglo_core.errors import OptionError

__all__ = ["Option", "Text", "convert", "options_of", "parse_value", "wants_registry"]

_WORDS = {"true": True, "false": False, "none": None}
_WORDS_OF: dict[Any, str] = {
    bool: "true or false",
    int: "a whole number",
    float: "a number",
    str: "a text",
    Path: "a path",
    type(None): "none",
    None: "none",
}
_EMPTY = inspect.Parameter.empty


class Text(str):
    """A value as it was typed, which is yet to become what its option takes."""

    __slots__ = ()


@dataclass(frozen=True)
class Option:
    """One option of a component.

    Attributes
    ----------
    name : str
    type : object
        Its annotation; ``inspect.Parameter.empty`` if there is none that could be read.
    default : object
        ``inspect.Parameter.empty`` if it must be given.
    about : str
        What the docstring of the component says of it, in one line.
    """

    name: str
    type: Any
    default: Any
    about: str = ""

    @property
    def required(self) -> bool:
        """Whether a value must be given."""
        return self.default is _EMPTY

    @property
    def type_name(self) -> str:
        """The type in words: ``a whole number``, ``'lu' or 'dense'``."""
        return _in_words(self.type)


def options_of(target: Callable[..., Any]) -> tuple[Option, ...] | None:
    """Options of a class or factory; None if it takes any, or does not say (it then checks them itself)."""
    return _options_of_class(target) if isinstance(target, type) else _options_of(target)


def _options_of(target: Callable[..., Any]) -> tuple[Option, ...] | None:
    try:
        parameters = inspect.signature(target).parameters.values()
    except (TypeError, ValueError):
        return None
    if any(p.kind is p.VAR_KEYWORD for p in parameters):
        return None
    handed = {"registry"} if wants_registry(target) else set()
    about = _described(target)
    return tuple(
        Option(p.name, _with_default(_annotation(target, p), p.default), p.default, about.get(p.name, ""))
        for p in parameters
        if p.kind in (p.POSITIONAL_OR_KEYWORD, p.KEYWORD_ONLY) and p.name not in handed
    )


def wants_registry(target: Callable[..., Any]) -> bool:
    """Whether a class or factory asks, by ``*, registry=None``, for the registry that builds it.

    It is no option: users never see it.
    """
    return _class_wants_registry(target) if isinstance(target, type) else _wants_registry(target)


@lru_cache(maxsize=256)
def _class_wants_registry(target: type) -> bool:
    return _wants_registry(target)


def _wants_registry(target: Callable[..., Any]) -> bool:
    try:
        asked = inspect.signature(target).parameters.get("registry")
    except (TypeError, ValueError):
        return False
    return asked is not None and asked.kind is asked.KEYWORD_ONLY and asked.default is None


@lru_cache(maxsize=256)
def _options_of_class(target: type) -> tuple[Option, ...] | None:
    return _options_of(target)  # takes longer than to build most components, so once for each class


def parse_value(text: str) -> int | float | bool | str | None:
    """An integer, a number, true, false or none if ``text`` looks like one; otherwise the text itself."""
    if text.lower() in _WORDS:
        return _WORDS[text.lower()]
    for number in (int, float):
        try:
            return number(text)
        except ValueError:
            continue
    return str(text)


def convert(option: Option, value: Any, owner: str) -> Any:
    """The value as the option takes it.

    Raises
    ------
    OptionError
        If it does not fit; says what was given, what was expected and whose option it is.
    """
    known = _members(option.type)
    if known is None:
        return parse_value(value) if isinstance(value, Text) else value
    for member in known:
        found, result = _fit(member, value)
        if found:
            return result
    given = parse_value(value) if isinstance(value, Text) else value
    if (
        isinstance(given, str | int | float)
        and type(given) is type(option.default)
        and given == option.default
    ):
        return given
    raise OptionError(f"{option.name} of {owner} must be {option.type_name}, given {given!r:.60}")


def _members(annotation: Any) -> tuple[Any, ...] | None:
    """The types of a union, text last; None if one of them is not of those that options know."""
    members = get_args(annotation) if get_origin(annotation) in (Union, types.UnionType) else (annotation,)
    if not all(_is_known(member) for member in members):
        return None
    return tuple(sorted(members, key=lambda member: member in (str, Path)))


def _is_known(member: Any) -> bool:
    if get_origin(member) is Literal or member in (bool, int, float, str, Path, type(None), None):
        return True
    if get_origin(member) is tuple:
        return all(each is Ellipsis or _members(each) is not None for each in get_args(member))
    return isinstance(member, type) and issubclass(member, Enum)


def _fit(member: Any, value: Any) -> tuple[bool, Any]:
    """Whether a value fits one type, and what it becomes."""
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
    """A text as a value of a plain type."""
    if member is str:
        return True, str(text)
    if member is Path:
        return True, Path(text)
    if member in (bool, None, type(None)):
        wanted: tuple[Any, ...] = (True, False) if member is bool else (None,)
        word = _WORDS.get(text.lower(), _EMPTY)
        return word in wanted and word is not _EMPTY, word
    try:
        return True, member(text)
    except ValueError:
        return False, None


def _is_instance(member: type, value: Any) -> bool:
    """Whether a value is of a plain type; numbers of numpy are numbers, a bool is none."""
    if member is bool:
        return isinstance(value, bool) or type(value).__name__ in ("bool", "bool_")
    if member is str:
        return isinstance(value, str)
    if isinstance(value, bool) or not hasattr(value, "__float__") or getattr(value, "ndim", 0) != 0:
        return False
    return member is float or hasattr(value, "__index__")


def _fit_literal(accepted: tuple[Any, ...], value: Any) -> tuple[bool, Any]:
    for each in accepted:
        if isinstance(value, Text):
            found, read = _fit(type(each), value)
            if found and read == each:
                return True, each
        elif type(value) is type(each) and value == each:
            return True, each
    return False, None


def _fit_enum(member: type[Enum], value: Any) -> tuple[bool, Any]:
    if isinstance(value, member):
        return True, value
    for each in member:
        if value == each.name or value == each.value or str(value) == str(each.value):
            return True, each
    return False, None


def _fit_tuple(members: tuple[Any, ...], value: Any) -> tuple[bool, Any]:
    """A list or tuple item by item; a text is split at ``+``, as commas separate options."""
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
        tried = [_fit(each, item) for each in _members(kind) or ()]
        good = [result for found, result in tried if found]
        if not good:
            return False, None
        results.append(good[0])
    return True, tuple(results)


def _annotation(target: Callable[..., Any], parameter: inspect.Parameter) -> Any:
    """The annotation itself, evaluated if it is a string; empty where the string cannot be evaluated."""
    given = parameter.annotation
    if not isinstance(given, str):
        return given
    function: Any = target.__init__ if isinstance(target, type) else target  # type: ignore[misc]
    names = getattr(inspect.unwrap(function), "__globals__", None)
    if names is None:  # a dataclass: its __init__ was made elsewhere
        names = vars(inspect.getmodule(target) or types.ModuleType("none"))
    try:
        return eval(given, dict(names))
    except Exception:  # a name that is imported for type checkers alone
        return _EMPTY


def _with_default(annotation: Any, default: Any) -> Any:
    """The annotation, with None if that is the default: many write ``int = None``."""
    if default is not None or _members(annotation) is None:
        return annotation
    return Optional[annotation]  # noqa: UP045 - None | None is an error


def _described(target: Callable[..., Any]) -> dict[str, str]:
    """First sentence of what a numpydoc docstring says of each parameter, or attribute."""
    text = inspect.getdoc(target) or ""
    about: dict[str, str] = {}
    for head in ("Parameters", "Attributes"):
        section = re.search(rf"^{head}\n-+\n(.*?)(?=^\w[^\n]*\n-+\n|\Z)", text, re.M | re.S)
        entries = re.split(r"^(?=\w)", section[1] if section else "", flags=re.M)
        for entry in entries:
            names, _, body = entry.partition("\n")
            words = " ".join(body.split())
            sentence = re.match(r".*?[.](?= |$)|.*", words)
            for name in names.partition(":")[0].split(","):
                about.setdefault(name.strip(), sentence[0].rstrip(".") if sentence else "")
    return about


def _in_words(annotation: Any) -> str:
    if annotation is _EMPTY:
        return "any"
    if get_origin(annotation) in (Union, types.UnionType):
        return " or ".join(_in_words(member) for member in get_args(annotation))
    if get_origin(annotation) is Literal:
        return " or ".join(repr(each) for each in get_args(annotation))
    if get_origin(annotation) is tuple:
        return f"tuple of {', '.join('…' if m is Ellipsis else _in_words(m) for m in get_args(annotation))}"
    if isinstance(annotation, type) and issubclass(annotation, Enum):
        return " or ".join(repr(each.name) for each in annotation)
    return _WORDS_OF.get(annotation, str(getattr(annotation, "__name__", annotation)))
