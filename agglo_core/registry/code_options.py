"""Options that name code: what a file says may not import anything unless the user allows it.

A component marks such an option by its annotation, and imports the code itself::

    def __init__(self, network: ImportPath | None = None) -> None: ...

The command line and Python hand the text over as it is: whoever types it decides. Texts of a TOML file are
marked as :class:`Written`, and one that arrives at such an option is refused before anything is imported.
"""

from __future__ import annotations

from collections.abc import Mapping
from typing import Annotated, Any, Final, get_args, get_origin

_MARK: Final = "agglo: names code that is imported"

ImportPath = Annotated[str, _MARK]
"""Annotation of an option that names code to import: ``"module:attribute"``."""


class Written(str):
    """A text from a file, which must not name code."""

    __slots__ = ()


def names_code(annotation: Any) -> bool:
    """Return True if an annotation is :data:`ImportPath`, or a tuple or a union that holds it."""
    if get_origin(annotation) is Annotated and _MARK in annotation.__metadata__:
        return True
    return any(names_code(each) for each in get_args(annotation))


def written(value: Any) -> Any:
    """A value of a file with all its texts marked, those in lists and tables too."""
    if isinstance(value, str):
        return Written(value)
    if isinstance(value, list | tuple):
        return [written(each) for each in value]
    if isinstance(value, Mapping):
        return {key: written(each) for key, each in value.items()}
    return value


def is_written(value: Any) -> bool:
    """Return True for a text from a file, or a list or table with one in it."""
    if isinstance(value, list | tuple):
        return any(is_written(each) for each in value)
    if isinstance(value, Mapping):
        return any(is_written(each) for each in value.values())
    return isinstance(value, Written)


def plain(value: Any) -> Any:
    """The text without its mark, for an option that takes any text; texts in lists likewise."""
    if isinstance(value, list):
        return [plain(each) for each in value]
    return str(value) if isinstance(value, Written) else value
