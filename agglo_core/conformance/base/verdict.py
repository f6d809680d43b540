"""Exception for a component that breaks a law."""

from __future__ import annotations

ATTRIBUTES = "required attributes"
"""Cause of failures by attributes that are missing or invalid."""
FORM = "form of the result"
"""Cause of failures by a result of another type or shape."""


class Broken(Exception):
    """Exception raised if a component breaks a law.

    Parameters
    ----------
    message : str
        The fault and its remedy.
    cause : str
        Key of the cause; failures with equal keys are reported once. Empty if the fault is the law's own.
    code : str
        Lines of Python that make the arguments of the failing call; empty if they are not drawn.
    """

    def __init__(self, message: str, cause: str = "", code: str = "") -> None:
        super().__init__(message)
        self.cause, self.code = cause, code


def require(holds: object, message: str, cause: str = "") -> None:
    """Raise :class:`Broken` with the message if the condition ``holds`` is false."""
    if not holds:
        raise Broken(message, cause)
