"""Options that name code to import: refused in files unless the user allows it.

A component marks such an option by its annotation, and imports the code itself::

    def __init__(self, network: ImportPath | None = None) -> None: ...

Texts from the command line and from Python pass unchanged, because their author decides. Texts from TOML
files are marked as :class:`Written`; for such options they are rejected before anything is imported.
"""

from __future__ import annotations

from collections.abc import Mapping
from typing import Annotated, Any, Final, get_args, get_origin

_MARK: Final = "agglo: names code that is imported"

ImportPath = Annotated[str, _MARK]
"""Annotation of an option that refers to code: ``"module:attribute"``."""


class Written(str):
    """A text read from a file, which must not name code to import."""

    __slots__ = ()


def names_code(annotation: Any) -> bool:
    """Return True if a type annotation is :data:`ImportPath`, or a tuple or union that contains it."""
    if get_origin(annotation) is Annotated and _MARK in annotation.__metadata__:
        return True
    return any(names_code(argument) for argument in get_args(annotation))


def mark_texts(value: Any) -> Any:
    """Mark all texts in a value as read from a file, including those in lists and tables."""
    if isinstance(value, str):
        return Written(value)
    if isinstance(value, list | tuple):
        return [mark_texts(item) for item in value]
    if isinstance(value, Mapping):
        return {key: mark_texts(item) for key, item in value.items()}
    return value


def is_written(value: Any) -> bool:
    """Return True for a text marked as read from a file, or a list or table that contains one."""
    if isinstance(value, list | tuple):
        return any(is_written(item) for item in value)
    if isinstance(value, Mapping):
        return any(is_written(item) for item in value.values())
    return isinstance(value, Written)


def plain(value: Any) -> Any:
    """Remove the mark of texts read from a file, for options that accept any text."""
    if isinstance(value, list):
        return [plain(item) for item in value]
    return str(value) if isinstance(value, Written) else value
