"""Execution of plugin code that cannot end the program, mix with its output or change its folder."""

from __future__ import annotations

import logging
import os
import sys
from collections.abc import Iterator
from contextlib import contextmanager, redirect_stdout

PLUGIN_FAILURES = (Exception, SystemExit)
"""Exceptions that a component may raise without ending the program.

While a plugin is loaded, all exceptions except KeyboardInterrupt are contained, see :func:`contain_loading`.
During a run, other BaseExceptions stop the program (cancelled tasks, alarms), because they are not failures
of a component.
"""


class LoadingError(Exception):
    """Exception raised by a plugin during its import or in a hook.

    The original exception is the cause.
    """


@contextmanager
def contain_loading(what: str) -> Iterator[None]:
    """Run plugin code, convert its exceptions to LoadingError, and keep its output off stdout.

    Its output goes to stderr, or to the current redirection of stdout.

    Raises
    ------
    LoadingError
        For any exception, with the message from :func:`describe_error`.
    KeyboardInterrupt
        Unchanged, with a note about ``what``, because the user or the plugin may have caused it.
    """
    elsewhere = sys.stderr if sys.stdout is sys.__stdout__ else sys.stdout
    try:
        with redirect_stdout(elsewhere), restore_folder(what):
            yield
    except KeyboardInterrupt as interrupt:
        interrupt.add_note(f"while loading {what}")
        raise
    except BaseException as error:
        raise LoadingError(describe_error(error)) from error


@contextmanager
def restore_folder(what: str) -> Iterator[None]:
    """Restore the working directory if code in the block changes it, and warn with the name ``what``."""
    home = _folder()
    try:
        yield
    finally:
        if home and _folder() != home:
            os.chdir(home)
            logging.getLogger("agglo").warning("%s changed the current folder; it was changed back", what)


def _folder() -> str:
    try:
        return os.getcwd()
    except OSError:  # the folder was deleted
        return ""


def describe_error(error: BaseException) -> str:
    """Return an exception as ``ValueError: message``, even one whose message cannot be printed."""
    try:
        message = str(error)
    except PLUGIN_FAILURES:
        message = "(its message cannot be printed)"
    return printable(f"{type(error).__name__}: {message}".rstrip(": "))


def shown(value: object, limit: int = 60) -> str:
    """Return ``repr(value)`` cut at ``limit`` characters, or the type name if ``repr`` fails."""
    try:
        return printable(f"{value!r:.{limit}}")
    except PLUGIN_FAILURES:
        return f"a {type(value).__name__} that cannot be printed"


def printable(text: str) -> str:
    """Escape control characters in a text from an untrusted source.

    Line breaks are kept.
    """
    if text.isprintable():
        return text
    return "".join(map(_escape_character, text))


def _escape_character(character: str) -> str:
    if character == "\n" or character.isprintable() or "\ud800" <= character <= "\udfff":
        return character
    return " " if character.isspace() else character.encode("unicode_escape").decode()
