"""Run code of plugins so that it cannot end the program, spoil its output or change its folder."""

from __future__ import annotations

import logging
import os
import sys
from collections.abc import Iterator
from contextlib import contextmanager, redirect_stdout

PLUGIN_FAILURES = (Exception, SystemExit)
"""Exceptions that a component may raise without ending the program.

While a plugin is loaded it may raise anything but a KeyboardInterrupt: see :func:`loading`. During a run
other BaseExceptions stop the program (cancelled tasks, alarms) and are no failure of a component.
"""


class LoadingError(Exception):
    """A plugin raised while it was loaded; the cause is what it raised."""


@contextmanager
def loading(what: str) -> Iterator[None]:
    """Run a plugin's code at import or in a hook: failures become LoadingErrors, and stdout stays clean.

    What it prints goes to stderr, or to where stdout has been redirected.

    Raises
    ------
    LoadingError
        If it raises whatever it may be; the message is that of :func:`raised`.
    KeyboardInterrupt
        As it is, with a note of ``what`` was loaded: it may be the user's, or raised by the plugin.
    """
    elsewhere = sys.stderr if sys.stdout is sys.__stdout__ else sys.stdout
    try:
        with redirect_stdout(elsewhere), folder_kept(what):
            yield
    except KeyboardInterrupt as interrupt:
        interrupt.add_note(f"while loading {what}")
        raise
    except BaseException as error:
        raise LoadingError(raised(error)) from error


@contextmanager
def folder_kept(what: str) -> Iterator[None]:
    """Go back to the current folder if the code within has left it, with a warning that names ``what``."""
    home = _folder()
    try:
        yield
    finally:
        if home and _folder() != home:
            os.chdir(home)
            logging.getLogger("agglo").warning("%s changed the current folder; changed back", what)


def _folder() -> str:
    try:
        return os.getcwd()
    except OSError:  # it has been deleted
        return ""


def raised(error: BaseException) -> str:
    """``ValueError: message`` of an exception, even of one that cannot be printed."""
    try:
        message = str(error)
    except PLUGIN_FAILURES:
        message = "(its message cannot be printed)"
    return printable(f"{type(error).__name__}: {message}".rstrip(": "))


def shown(value: object, limit: int = 60) -> str:
    """``repr(value)`` cut at ``limit`` characters; the type of a value that cannot be printed."""
    try:
        return printable(f"{value!r:.{limit}}")
    except PLUGIN_FAILURES:
        return f"a {type(value).__name__} that cannot be printed"


def printable(text: str) -> str:
    """The text without control characters, which names from elsewhere may hold; line breaks stay."""
    if text.isprintable():
        return text
    return "".join(map(_visible, text))


def _visible(character: str) -> str:
    if character == "\n" or character.isprintable() or "\ud800" <= character <= "\udfff":
        return character
    return " " if character.isspace() else character.encode("unicode_escape").decode()
