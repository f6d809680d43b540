"""The errors agglo raises for bad input, files and components; the command line exits with 2 on each."""

from __future__ import annotations

__all__ = ["AggloError", "FileError", "MeshError", "OptionError", "PluginError"]


class AggloError(Exception):
    """Base of all errors raised on purpose; the message says what was given, what was expected, and where."""


class MeshError(AggloError, ValueError):
    """A mesh or graph that breaks a rule; the message names cells or faces."""


class OptionError(AggloError, ValueError):
    """A target, option or argument outside what is accepted."""


class FileError(AggloError, ValueError):
    """A file that cannot be read or written; the message names it."""


class PluginError(AggloError, RuntimeError):
    """A component that is missing, unusable or misbehaved; names component, plugin, distribution."""
