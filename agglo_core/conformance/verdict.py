"""What a law says of a component that breaks it."""

from __future__ import annotations

__all__ = ["Broken", "require"]


class Broken(Exception):
    """A law that does not hold; the message says what was seen and what to do about it."""


def require(holds: object, message: str) -> None:
    """Raise :class:`Broken` with the message unless ``holds``."""
    if not holds:
        raise Broken(message)
