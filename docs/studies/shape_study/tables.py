"""Tables of a study: correlations of metrics, cost of bad shapes, outcomes of recipes."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from agglo_paper.tables.record import Cell, Row, Table
from shape_study.ranks import Measured, correlations, costs, relative


@dataclass(frozen=True)
class Group:
    """Partitions that are compared with one another.

    Attributes
    ----------
    key : str
        Begins the names of its tables; empty if it is alone.
    title : str
        Ends their titles.
    rows : sequence of Measured
    kinds : sequence of str
        What is measured, without the degree.
    degrees : sequence of int
        Empty where outcomes have no degree.
    """

    key: str
    title: str
    rows: Sequence[Measured]
    kinds: Sequence[str]
    degrees: Sequence[int] = ()

    def outcomes(self, kind: str) -> list[str]:
        """Names of the outcomes of a kind, one for each degree it has."""
        return [name for name in (*(f"{kind} p{degree}" for degree in self.degrees), kind) if self._has(name)]

    def _has(self, outcome: str) -> bool:
        return outcome in self.rows[0].result["outcomes"]

    @property
    def metrics(self) -> list[str]:
        """Names of the metrics."""
        return list(self.rows[0].result["metrics"])

    @property
    def sources(self) -> list[str]:
        """The meshes."""
        return list(dict.fromkeys(row.source for row in self.rows))

    def named(self, name: str) -> str:
        """Name of a table."""
        return "-".join(filter(None, (self.key, name)))

    def titled(self, title: str) -> str:
        """Title of a table."""
        return ", ".join(filter(None, (title, self.title)))


def tables(group: Group) -> list[Table]:
    """All tables of a group."""
    per_mesh, usual = len(group.rows) // len(group.sources), [row for row in group.rows if row.usual]
    together = ", degrees together" if group.degrees else ""
    found = [_summary(group, "all", f"All {per_mesh} partitions of a mesh{together}", group.rows)]
    if usual:
        title = f"The usual methods alone, {len(usual) // len(group.sources)} of a mesh"
        found.append(_summary(group, "usual", title, usual))
    if "parts" in group.metrics:
        title = f"All {per_mesh} partitions{together}, the number of parts taken out"
        found.append(_summary(group, "partial", title, group.rows, "parts"))
    if group.degrees:
        found += [_of_degree(group, degree) for degree in group.degrees]
    return [*found, _costs(group), _recipes(group)]


def _summary(group: Group, name: str, title: str, rows: Sequence[Measured], given: str = "") -> Table:
    """Correlations, the mean over the degrees; the best metrics come first."""
    columns: dict[str, dict[str, float]] = {metric: {} for metric in group.metrics if metric != given}
    for kind in (each for each in group.kinds if each != given):
        for metric, values in correlations(rows, columns, group.outcomes(kind), given).items():
            known = [each for each in values if np.isfinite(each)]
            columns[metric][kind] = float(np.mean(known)) if known else float("nan")
    of = "degrees and meshes" if group.degrees else "meshes"
    what = "partial rank correlations" if given else "rank correlations"
    note = f"mean of the {what} over {of}; the metrics in the order of their means"
    return Table(group.named(name), group.titled(title), _ranked(columns), 2, "metric", [note])


def _of_degree(group: Group, degree: int) -> Table:
    kinds = [kind for kind in group.kinds if f"{kind} p{degree}" in group.outcomes(kind)]
    found = correlations(group.rows, group.metrics, [f"{kind} p{degree}" for kind in kinds])
    columns = {metric: dict(zip(kinds, values, strict=True)) for metric, values in found.items()}
    title = group.titled(f"All partitions, p = {degree}")
    return Table(group.named(f"p{degree}"), title, _ranked(columns), 2, "metric")


def _ranked(columns: dict[str, dict[str, float]]) -> list[Row]:
    """A row for each metric that is defined somewhere, those that tell most first."""

    def mean(metric: str) -> float:
        known = [each for each in columns[metric].values() if np.isfinite(each)]
        return float(np.mean(known)) if known else -np.inf

    names = sorted((name for name in columns if np.isfinite(mean(name))), key=mean, reverse=True)
    return [Row(name, {kind: Cell(each) for kind, each in columns[name].items()}) for name in names]


def _costs(group: Group) -> Table:
    suffixes = {f", p = {degree}": f" p{degree}" for degree in group.degrees} or {"": ""}
    found = {
        text: costs(group.rows, [_name(group, kind, suffix) for kind in group.kinds])
        for text, suffix in suffixes.items()
    }
    lines = [
        Row(f"{who}{text}", {kind: Cell(each) for kind, each in zip(group.kinds, own[who], strict=True)})
        for who in next(iter(found.values()))
        for text, own in found.items()
    ]
    return Table(group.named("costs"), group.titled("What bad shapes cost"), lines, 2, "partitions")


def _name(group: Group, kind: str, suffix: str) -> str:
    """The outcome of a kind for a degree, or the only one."""
    names = group.outcomes(kind)
    return f"{kind}{suffix}" if f"{kind}{suffix}" in names else names[0]


def _recipes(group: Group) -> Table:
    """How each recipe does, over the best partition of each mesh, degrees together."""
    table: dict[str, dict[str, float]] = {}
    for kind in group.kinds:
        for recipe, values in relative(group.rows, group.outcomes(kind)).items():
            table.setdefault(recipe, {})[kind] = float(np.exp(np.log(values).mean()))
    ordered = sorted(table, key=lambda recipe: float(np.log(list(table[recipe].values())).mean()))
    lines = [Row(recipe, {kind: Cell(each) for kind, each in table[recipe].items()}) for recipe in ordered]
    of = "meshes, seeds and degrees" if group.degrees else "meshes and seeds"
    note = f"over the best partition of each mesh: geometric means over {of}"
    return Table(group.named("recipes"), group.titled("How the partitions do"), lines, 2, "partition", [note])
