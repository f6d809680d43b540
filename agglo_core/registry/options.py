"""Component options, derived from the class signature: names, types, checks.

An option is a constructor keyword. Its type is the annotation: bool, int, float, str, ``Literal[…]``,
an Enum, Path, a tuple of these, or a union, also with None. The default always fits: ``int = None`` accepts
None. The same rules apply on the command line (where every value is a text), in TOML and in Python. An
:data:`~agglo_core.registry.code_options.ImportPath` is a text that refers to code, allowed in a TOML file
only with the user's permission. Options with another annotation, or none, accept any value; texts are then
converted by their form: number, true, false, none, or text.
"""

from __future__ import annotations

import inspect
import re
import types
from collections.abc import Callable, Mapping
from dataclasses import dataclass, fields, is_dataclass
from functools import lru_cache
from itertools import product
from typing import Any, ForwardRef, Optional, TypeGuard

from agglo_core.errors import OptionError
from agglo_core.registry.code_options import is_written, names_code
from agglo_core.registry.containment import shown
from agglo_core.registry.option_types import UNTYPED, Text, fit, in_words, parse_value

_MARKUP = re.compile(r"(?::\w+:)?`+~?([^`]*)`+")
"""Names in a docstring in reStructuredText markup, such as :meth:`bisect`."""


@dataclass(frozen=True)
class Option:
    """An option of a component: name, type, default and description.

    Attributes
    ----------
    name : str
    type : object
        Its annotation; ``inspect.Parameter.empty`` without an annotation or if evaluation fails.
    default : object
        ``inspect.Parameter.empty`` for required options.
    about : str
        One line from the component docstring.
    """

    name: str
    type: Any
    default: Any
    about: str = ""

    @property
    def required(self) -> bool:
        """True if the option has no default."""
        return self.default is UNTYPED

    @property
    def type_name(self) -> str:
        """Type of the option in words: ``a whole number``, ``'lu' or 'dense'``."""
        return in_words(self.type)


def options_of(target: Callable[..., Any]) -> tuple[Option, ...] | None:
    """Return the options of a class or factory, from its signature.

    None if it accepts any keyword, or has no signature. In the latter case it checks the options itself.
    """
    return _options_of_class(target) if isinstance(target, type) else _options_of(target)


def _options_of(target: Callable[..., Any]) -> tuple[Option, ...] | None:
    try:
        parameters = inspect.signature(target).parameters.values()
    except (TypeError, ValueError):
        return None
    if any(p.kind is p.VAR_KEYWORD for p in parameters):
        return None
    handed = {"registry"} if wants_registry(target) else set()
    about, made = _describe_parameters(target), _made_defaults(target)
    return tuple(
        Option(p.name, _with_default(_annotation(target, p), p.default), default, about.get(p.name, ""))
        for p in parameters
        for default in [made.get(p.name, p.default)]
        if p.kind in (p.POSITIONAL_OR_KEYWORD, p.KEYWORD_ONLY) and p.name not in handed
    )


def _made_defaults(target: Any) -> Mapping[str, Any]:
    """Return the empty containers that are defaults of a dataclass, by field name."""
    factories = {each.name: each.default_factory for each in (fields(target) if is_dataclass(target) else ())}
    return {name: factory() for name, factory in factories.items() if factory in (dict, list, set)}


def wants_registry(target: Callable[..., Any]) -> bool:
    """Return True if a class or factory has the parameter ``*, registry=None`` to receive the registry.

    This parameter is no option, and no listing shows it.
    """
    return _class_wants_registry(target) if isinstance(target, type) else _wants_registry(target)


@lru_cache(maxsize=256)
def _class_wants_registry(target: type) -> bool:
    return _wants_registry(target)


def _wants_registry(target: Callable[..., Any]) -> bool:
    try:
        parameter = inspect.signature(target).parameters.get("registry")
    except (TypeError, ValueError):
        return False
    return parameter is not None and parameter.kind is parameter.KEYWORD_ONLY and parameter.default is None


@lru_cache(maxsize=256)
def _options_of_class(target: type) -> tuple[Option, ...] | None:
    return _options_of(target)  # slower than building most components, hence cached per class


def is_named(choice: object) -> TypeGuard[str | tuple[Any, ...]]:
    """Return True for a name or a tuple ``(name, options)``, but not for an object that is a NamedTuple."""
    return isinstance(choice, str) or type(choice) is tuple


def name_and_options(kind: str, choice: str | tuple[Any, ...]) -> tuple[str, Mapping[str, Any]]:
    """Return the name and the options of a choice by name, or raise OptionError for another form."""
    if isinstance(choice, str):
        return choice, {}
    if len(choice) == 2 and isinstance(choice[0], str) and isinstance(choice[1], Mapping):
        return choice[0], choice[1]
    raise OptionError(f"a {kind} must be a name, (name, options) or an object, given {shown(choice)}")


def convert(option: Option, value: Any, owner: str) -> Any:
    """Convert a value to the option type.

    Raises
    ------
    OptionError
        For a value of another type, with the value, the expected type and the owner of the option; also for
        a value from a file that refers to code.
    """
    if names_code(option.type) and is_written(value):
        raise OptionError(
            f"{option.name} of {owner} comes from a file and names code to import and run, "
            f"{value!r:.80}; if you trust the file, allow it with --allow-code, or "
            "allow_code=True in Python"
        )
    fits, result = fit(option.type, value)
    if fits:
        return result
    plain_value = parse_value(value) if isinstance(value, Text) else value
    if (
        isinstance(plain_value, str | int | float)
        and type(plain_value) is type(option.default)
        and plain_value == option.default
    ):
        return plain_value
    raise OptionError(f"{option.name} of {owner} must be {option.type_name}, given {shown(plain_value)}")


def _annotation(target: Callable[..., Any], parameter: inspect.Parameter) -> Any:
    """Return a parameter's type annotation.

    A string annotation is evaluated; the result is empty if the evaluation fails.
    """
    annotation = parameter.annotation
    if isinstance(annotation, ForwardRef):  # the text of an annotation of a named tuple
        annotation = annotation.__forward_arg__
    if not isinstance(annotation, str):
        return annotation
    function: Any = target.__init__ if isinstance(target, type) else target  # type: ignore[misc]
    names = getattr(inspect.unwrap(function), "__globals__", None)
    if names is None:  # dataclass: __init__ is generated elsewhere
        names = vars(inspect.getmodule(target) or types.ModuleType("none"))
    try:
        return eval(annotation, dict(names))
    except (NameError, AttributeError, TypeError, SyntaxError):  # such as names for type checkers only
        return UNTYPED


def _with_default(annotation: Any, default: Any) -> Any:
    """Add None to the type of an option whose default is None, because ``int = None`` is common."""
    if default is not None or annotation is UNTYPED:
        return annotation
    return Optional[annotation]  # noqa: UP045 - None | None is an error


def _describe_parameters(target: Callable[..., Any]) -> dict[str, str]:
    """Return for each parameter the first sentence about it in the docstrings of a class and its bases."""
    about: dict[str, str] = {}
    bases = inspect.getmro(target) if isinstance(target, type) else (target,)
    for text, head in product([inspect.getdoc(base) or "" for base in bases], ("Parameters", "Attributes")):
        section = re.search(rf"^{head}\n-+\n(.*?)(?=^\w[^\n]*\n-+\n|\Z)", text, re.M | re.S)
        entries = re.split(r"^(?=\w)", section[1] if section else "", flags=re.M)
        for entry in entries:
            names, _, body = entry.partition("\n")
            words = _MARKUP.sub(r"\1", " ".join(body.split()))
            sentence = re.match(r".*?[.](?= |$)|.*", words)
            for name in names.partition(":")[0].split(","):
                about.setdefault(name.strip(), sentence[0].rstrip(".") if sentence else "")
    return about
