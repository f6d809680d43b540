"""The exception raised by a law that a component breaks."""

from __future__ import annotations


class Broken(Exception):
    """A law that does not hold; the message says what was found and what to do about it."""


def require(holds: object, message: str) -> None:
    """Raise :class:`Broken` with the message unless ``holds``."""
    if not holds:
        raise Broken(message)
