"""Exceptions for invalid input, unreadable files and faulty components.

The command line exits with 2 for each.
"""

from __future__ import annotations

__all__ = ["AggloError", "FileError", "MeshError", "OptionError", "PluginError"]


class AggloError(Exception):
    """Base of all exceptions that agglo raises on purpose.

    The message contains the given value, the expected value and the location.

    Examples
    --------
    >>> try:
    ...     agglo.samples.from_spec("square:n=4")
    ... except agglo.AggloError as error:
    ...     print(type(error).__name__)
    OptionError
    """


class MeshError(AggloError, ValueError):
    """Exception for a mesh or graph that violates a requirement.

    The message names cells or faces.

    Examples
    --------
    >>> agglo.Mesh.from_polygons([[0, 0], [1, 0], [1, 1]], [[0, 1, 5]])
    Traceback (most recent call last):
        ...
    agglo_core.errors.MeshError: cell 0 uses point 5, but there are 3 points
    """


class OptionError(AggloError, ValueError):
    """Exception for a target, option or argument outside the accepted values.

    Examples
    --------
    >>> agglo.Pipeline(seed=-1)
    Traceback (most recent call last):
        ...
    agglo_core.errors.OptionError: seed must be an integer in 0..2^63 − 1, given -1
    """


class FileError(AggloError, ValueError):
    """Exception for a file that cannot be read or written.

    The message names the file.

    Examples
    --------
    >>> agglo.read("no.vtu")
    Traceback (most recent call last):
        ...
    agglo_core.errors.FileError: no.vtu: no such file
    """


class PluginError(AggloError, RuntimeError):
    """Exception for a component that is missing, unusable or faulty.

    The message names component, plugin and distribution.

    Examples
    --------
    >>> agglo.registry.default().build("bisector", "nobody")
    Traceback (most recent call last):
        ...
    agglo_core.errors.PluginError: no bisector is named 'nobody'; available: ...
    """
