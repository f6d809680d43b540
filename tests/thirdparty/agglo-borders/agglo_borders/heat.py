"""Problem ``heat``."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any, ClassVar, Self

from agglo_core.authoring import Mesh, OptionError

__all__ = ["Heat"]


@dataclass(frozen=True)
class Heat:
    """Plate heated by ``source`` with a heat loss of ``loss`` times the temperature, insulated at its rim."""

    kind: ClassVar[str] = "heat"
    source: float = 1.0
    loss: float = 1.0

    @classmethod
    def from_table(cls, table: Mapping[str, Any], mesh: Mesh, folder: Path) -> Self:
        """Read a table such as ``source = 2.0`` and ``loss = 0.5``."""
        values = {key: value for key, value in table.items() if key != "kind"}
        for key, value in values.items():
            if key not in ("source", "loss") or not isinstance(value, int | float):
                raise OptionError(f"heat: cannot use {key} = {value!r}; there are source and loss, numbers")
        return cls(**values)

    @classmethod
    def example(cls, mesh: Mesh) -> Self:
        """Return a problem for any mesh."""
        return cls(source=3.0, loss=0.5)
