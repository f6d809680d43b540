"""A component and the law it is there to break."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Any

from agglo_core import Component

__all__ = ["Mutant"]


@dataclass(frozen=True)
class Mutant:
    """A component and the first law it breaks; ``says`` is part of the advice it gets.

    ``kind`` is for what has no method that would tell, such as a function that makes a sample.
    """

    law: str
    given: Any
    says: str = ""
    promises: Mapping[str, Any] = field(default_factory=dict)
    kind: str | None = None
    thorough: bool = False

    def __str__(self) -> str:
        name = self.given.name if isinstance(self.given, Component) else self.given.__name__
        return f"{self.law}-{name}"
