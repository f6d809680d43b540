"""The methods compared in the tables: the paper's, METIS with good options, every installed bisector."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import asdict, dataclass, field, replace
from typing import Any, Literal

from agglo_core.authoring import (
    AggloError,
    Hierarchy,
    Mesh,
    PluginError,
    Record,
    Registry,
    agglomerate,
    default,
)
from agglo_core.protocols import Partitioner

_PLAIN = {"vertex_weights": False, "edge_weights": False, "ufactor": 30, "contig": False}
_BEST = {"vertex_weights": True, "edge_weights": True, "ufactor": 300, "contig": True}
_RECURSIVE = ("gnn_paper",)  # bisectors that the paper applies recursively alone


@dataclass(frozen=True)
class Targets:
    """Agglomeration targets on all levels: largest diameters, or part counts for METIS."""

    sizes: tuple[float, ...]
    counts: tuple[int, ...]


@dataclass(frozen=True)
class Strategy:
    """An agglomeration method: bisector, options and pipeline, shown as a table column.

    Attributes
    ----------
    name : str
        Column heading.
    bisector : str
    options : mapping
    method : "recursive" or "kway"
    by_count : bool
        Use counts as targets, with a separate call per level, as the paper runs METIS.
    refined : bool
        Use the default refiner, the paper's "adjust partition"; otherwise none.
    varies : "", "numbering" or "seed"
        Further dependence of the result: tables then give median and range.
    package : str
        Package with the bisector.
    problem : str
        Reason if it cannot be used here.
    """

    name: str
    bisector: str
    options: Mapping[str, Any] = field(default_factory=dict)
    method: Literal["recursive", "kway"] = "recursive"
    by_count: bool = False
    refined: bool = True
    varies: Literal["", "numbering", "seed"] = ""
    package: str = ""
    problem: str = ""

    def data(self) -> dict[str, Any]:
        """Return the settings that identify the method, as plain data."""
        return {key: value for key, value in asdict(self).items() if key not in ("package", "problem")}

    def run(self, mesh: Mesh, targets: Targets, seed: int = 0) -> Hierarchy:
        """Agglomerate a mesh to the targets on all levels, finest first."""
        target_options: dict[str, Any] = (
            {"n_parts": targets.counts} if self.by_count else {"h_star": targets.sizes}
        )
        return agglomerate(
            mesh,
            bisector=(self.bisector, self.options),
            method=self.method,
            nested=not self.by_count,
            refiners=None if self.refined else (),
            polish=False,
            seed=seed,
            **target_options,
        )


def paper_columns() -> list[Strategy]:
    """Return the paper's methods: METIS as stated, its k-means, its network, METIS with good options."""
    return [
        Strategy("METIS", "metis", _PLAIN, "kway", by_count=True, refined=False, varies="numbering"),
        Strategy("k-means", "kmeans_sklearn", varies="seed"),
        Strategy("GNN", "gnn_paper"),
        Strategy("METIS, best options", "metis", _BEST, "kway", by_count=True, varies="numbering"),
    ]


def columns(
    registry: Registry | None = None, chosen: Mapping[str, tuple[str, Mapping[str, Any]]] | None = None
) -> list[Strategy]:
    """Return all methods: the paper's, then every registered bisector in agglo's default pipeline.

    ``chosen`` bisectors, name and options by column heading, replace the registered bisectors. A bisector
    that also partitions gets a second column, ``NAME k-way``. An unusable bisector stays, with its
    ``problem``; newly installed bisectors appear automatically.
    """
    registry = default() if registry is None else registry
    # 1. Registered or chosen bisectors
    if chosen is None:
        groups = [
            _list_strategies(record, registry) for record in registry.list() if record.kind == "bisector"
        ]
    else:
        groups = [
            _list_strategies(registry.record("bisector", name), registry, head, options)
            for head, (name, options) in chosen.items()
        ]
    # 2. Add them to the paper's columns, without its own bisectors: they have an equal pipeline there
    paper_bisectors = {strategy.bisector for strategy in paper_columns()[1:3]}
    extra = [strategy for group in groups for strategy in group if strategy.name not in paper_bisectors]
    return [_check_availability(strategy, registry) for strategy in paper_columns()] + extra


def _check_availability(strategy: Strategy, registry: Registry) -> Strategy:
    try:
        record = registry.record("bisector", strategy.bisector)
    except PluginError as error:
        return replace(strategy, problem=str(error))
    return replace(strategy, package=_package(record), problem=_problem(record))


def _list_strategies(
    record: Record, registry: Registry, head: str = "", user_options: Mapping[str, Any] | None = None
) -> list[Strategy]:
    name = f"{record.plugin}/{record.name}" if record.state == "conflict" else record.name
    head, options = head or name, dict(user_options or {})
    problem = "" if record.state == "conflict" else _problem(record)
    strategy = Strategy(head, name, options, package=_package(record), problem=problem)
    if strategy.problem:
        return [strategy]
    try:
        tool = registry.build("bisector", name, **options)
    except AggloError as error:
        return [Strategy(head, name, options, package=_package(record), problem=str(error))]
    bisects = [strategy] if hasattr(tool, "bisect") or hasattr(tool, "bisect_level") else []
    if isinstance(tool, Partitioner) and name not in _RECURSIVE:
        bisects.append(Strategy(f"{head} k-way", name, options, method="kway", package=_package(record)))
    return bisects


def _package(record: Record) -> str:
    return record.component.target.split(":")[0].split(".")[0] if record.component else ""


def _problem(record: Record) -> str:
    return "" if record.state == "ok" else f"{record.state}: {record.reason}"
