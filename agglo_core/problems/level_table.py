"""The levels of a multigrid method as a table."""

from __future__ import annotations

from collections.abc import Sequence


class LevelTable:
    """Unknowns and matrix entries of each level, printed as a table.

    Parameters
    ----------
    unknowns, entries : sequence of int
        Of each level, finest first.
    smoothers : sequence of str, optional
        What smooths each level, and what solves on the coarsest.

    Examples
    --------
    >>> from agglo_core.problems.level_table import LevelTable
    >>> LevelTable([360, 187], [6858, 1257], ["block Gauss-Seidel", "direct"])
    level  unknowns  entries  smoother
        0       360     6858  block Gauss-Seidel
        1       187     1257  direct
    """

    def __init__(
        self, unknowns: Sequence[int], entries: Sequence[int], smoothers: Sequence[str] = ()
    ) -> None:
        self.unknowns, self.entries, self.smoothers = tuple(unknowns), tuple(entries), tuple(smoothers)

    def __len__(self) -> int:
        return len(self.unknowns)

    def __repr__(self) -> str:
        columns = [
            ["level", *map(str, range(len(self)))],
            ["unknowns", *map(str, self.unknowns)],
            ["entries", *map(str, self.entries)],
        ]
        aligned = [[cell.rjust(max(map(len, column))) for cell in column] for column in columns]
        if self.smoothers:
            aligned.append(["smoother", *self.smoothers])
        return "\n".join("  ".join(row) for row in zip(*aligned, strict=True))
