"""Fields of a record that are made when they are first asked for."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any, TypeVar

_Record = TypeVar("_Record")


class Deferred:
    """A value that is made once, by ``make``, when it is first asked for; what made it is let go then.

    Examples
    --------
    >>> from agglo_core.authoring import Deferred
    >>> answer = Deferred(lambda: print("made") or 42)
    >>> answer.value, answer.value
    made
    (42, 42)
    """

    def __init__(self, make: Callable[[], Any]) -> None:
        self._make: Callable[[], Any] | None = make

    @property
    def value(self) -> Any:
        """The value."""
        if self._make is not None:
            self._value, self._make = self._make(), None
        return self._value


def deferrable(*names: str) -> Callable[[type[_Record]], type[_Record]]:
    """Decorator of a dataclass whose fields of these names take :class:`Deferred` values, too.

    Examples
    --------
    >>> from dataclasses import dataclass
    >>> @deferrable("total")
    ... @dataclass(frozen=True)
    ... class Sum:
    ...     total: int
    >>> Sum(3).total, Sum(Deferred(lambda: 1 + 2)).total
    (3, 3)
    """

    def marked(record: type[_Record]) -> type[_Record]:
        for name in names:
            setattr(record, name, _Field(name))
        return record

    return marked


class _Field:
    """A field of that name, whose value is made when it is read."""

    def __init__(self, name: str) -> None:
        self._name = name

    def __get__(self, instance: Any, owner: type) -> Any:
        if instance is None:
            raise AttributeError(self._name)  # as other fields, it is not an attribute of the class
        kept = vars(instance)
        if isinstance(kept[self._name], Deferred):
            kept[self._name] = kept[self._name].value
        return kept[self._name]

    def __set__(self, instance: Any, value: Any) -> None:
        vars(instance)[self._name] = value
