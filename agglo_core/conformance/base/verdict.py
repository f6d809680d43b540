"""Exception for a broken law."""

from __future__ import annotations


class Broken(Exception):
    """Violation of a law.

    The message states the fault and its remedy.
    """


def require(holds: object, message: str) -> None:
    """Raise :class:`Broken` with the message unless ``holds``."""
    if not holds:
        raise Broken(message)
