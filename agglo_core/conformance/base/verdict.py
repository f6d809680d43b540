"""Exception for a component that breaks a law."""

from __future__ import annotations


class Broken(Exception):
    """Exception raised if a component breaks a law.

    The message states the fault and its remedy.
    """


def require(holds: object, message: str) -> None:
    """Raise :class:`Broken` with the message if the condition ``holds`` is false."""
    if not holds:
        raise Broken(message)
