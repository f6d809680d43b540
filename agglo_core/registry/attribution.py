"""Errors of components, attributed: the message names component, plugin and distribution."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from typing import Any

from agglo_core.errors import AggloError, FileError, MeshError, OptionError, PluginError
from agglo_core.registry.containment import PLUGIN_FAILURES, folder_kept, raised


@dataclass(frozen=True)
class Member:
    """A component in use: the object that was built (``tool``) and its name in error messages (``title``).

    Examples
    --------
    >>> from agglo_core.authoring import InertialBisection, Member
    >>> member = Member(InertialBisection(), "bisector 'mine'")
    >>> type(member.tool).__name__, member.title
    ('InertialBisection', "bisector 'mine'")
    """

    tool: Any
    title: str

    def offers(self, *methods: str) -> bool:
        """Return True if it has one of these methods; isinstance with a protocol takes ten times as long."""
        return any(callable(getattr(self.tool, method, None)) for method in methods)


@contextmanager
def attributed(owner: str, *, spare: tuple[type[Exception], ...] = ()) -> Iterator[None]:
    """Put ``owner`` before what a component says on purpose; anything else it raises is a PluginError.

    An OptionError, MeshError or FileError about what the component was given stays one.

    A component that leaves the current folder is brought back, with a warning.

    Parameters
    ----------
    owner : str
        The component as :func:`~agglo_core.registry.describe` calls it.
    spare : tuple of exception types
        What passes as it is. A PluginError is given its owner even then.

    Examples
    --------
    >>> from agglo_core.authoring import attributed
    >>> with attributed("bisector 'mine'"):
    ...     1 / 0
    Traceback (most recent call last):
        ...
    agglo_core.errors.PluginError: bisector 'mine' raised ZeroDivisionError: division by zero
    """
    try:
        with folder_kept(owner):
            yield
    except PluginError as error:
        raise PluginError(f"{owner}: {error}") from error
    except spare:
        raise
    except AggloError as error:
        raise _family(error)(f"{owner}: {error}") from error
    except PLUGIN_FAILURES as error:
        raise PluginError(f"{owner} raised {raised(error)}") from error


def _family(error: AggloError) -> type[AggloError]:
    """The class of ours an error belongs to; one of a stranger's own may be made otherwise."""
    return next((each for each in (MeshError, OptionError, FileError) if isinstance(error, each)), AggloError)
