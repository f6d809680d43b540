"""Exceptions in components: messages name the component, its plugin and its distribution."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from typing import Any

from agglo_core.errors import AggloError, FileError, MeshError, OptionError, PluginError
from agglo_core.registry.containment import PLUGIN_FAILURES, describe_error, restore_folder


@dataclass(frozen=True)
class Member:
    """A component object (``tool``) with its name in error messages (``title``).

    Examples
    --------
    >>> from agglo_core.authoring import InertialBisection
    >>> from agglo_core.registry.attribution import Member
    >>> member = Member(InertialBisection(), "bisector 'mine'")
    >>> type(member.tool).__name__, member.title
    ('InertialBisection', "bisector 'mine'")
    """

    tool: Any
    title: str

    def offers(self, *methods: str) -> bool:
        """Return True if the component has at least one of the methods.

        This is ten times faster than isinstance with a protocol.
        """
        return any(callable(getattr(self.tool, method, None)) for method in methods)


@contextmanager
def attributed(owner: str, *, spare: tuple[type[Exception], ...] = ()) -> Iterator[None]:
    """Put the name ``owner`` before the messages of exceptions raised by a component within the context.

    OptionErrors, MeshErrors and FileErrors about the input keep their class. Exceptions other than
    AggloErrors become PluginErrors. If the component changes the current folder, the folder is restored with
    a warning.

    Parameters
    ----------
    owner : str
        The component, as labelled by :func:`~agglo_core.registry.describe`.
    spare : tuple of exception types
        Exceptions that pass unchanged. A PluginError gets its owner nevertheless.

    Examples
    --------
    >>> from agglo_core.registry.attribution import attributed
    >>> with attributed("bisector 'mine'"):
    ...     1 / 0
    Traceback (most recent call last):
        ...
    agglo_core.errors.PluginError: bisector 'mine' raised ZeroDivisionError: division by zero
    """
    try:
        with restore_folder(owner):
            yield
    except PluginError as error:
        raise PluginError(f"{owner}: {error}") from error
    except spare:
        raise
    except AggloError as error:
        raise _family(error)(f"{owner}: {error}") from error
    except PLUGIN_FAILURES as error:
        raise PluginError(f"{owner} raised {describe_error(error)}") from error


def _family(error: AggloError) -> type[AggloError]:
    """Return the class of agglo's own exceptions to which an exception belongs.

    Subclasses in plugins may have other constructors.
    """
    return next((kind for kind in (MeshError, OptionError, FileError) if isinstance(error, kind)), AggloError)
