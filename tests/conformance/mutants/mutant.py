"""Component together with the law it breaks."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Any

from agglo_core import Component

__all__ = ["Mutant"]


@dataclass(frozen=True)
class Mutant:
    """Component, the first law it breaks, and a part of the message in ``says``.

    ``kind`` is needed if no method identifies the kind, as for a function that makes a sample.
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
