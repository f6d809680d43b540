"""``agglo run`` on several MPI ranks: each agglomerates part of the mesh, rank 0 prints the table."""

from __future__ import annotations

import math
import time
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import TYPE_CHECKING, Any

from agglo_core.cli.options.specs import choice, load_mesh
from agglo_core.cli.output.console import number, print_json
from agglo_core.cli.output.files import refuse_input
from agglo_core.cli.output.tables import print_lines
from agglo_core.cli.ranks.launch import find_launch
from agglo_core.cli.runs import level_data, show, show_progress, warm_up
from agglo_core.errors import OptionError
from agglo_core.progress import phase

if TYPE_CHECKING:
    from agglo_core.distributed import DistributedHierarchy, DistributedMesh, Ranks


def is_of_ranks(output: Path | None, independent: bool) -> bool:
    """Return True if the options or an MPI launcher call for the distributed algorithm."""
    pieces = output is not None and output.suffix.lower() == ".pvtu"
    return find_launch() is not None or pieces or independent


@dataclass(frozen=True)
class _Level:
    """Data of one level, as :class:`agglo_core.measure.Level` but without values of single parts."""

    target: Mapping[str, Any]
    line: Mapping[str, Any]
    metrics: Sequence[str]
    objectives: Mapping[str, float] = field(default_factory=dict)
    undefined: Mapping[str, int] = field(default_factory=dict)


@dataclass(frozen=True)
class _Run:
    """Result of a distributed run, with the attribute names of :class:`agglo_core.measure.RunResult`."""

    name: str
    hierarchy: DistributedHierarchy
    levels: Sequence[_Level]
    seconds: float
    cpu_seconds: float
    error: str = ""


def run_on_ranks(
    source: str,
    bisectors: Sequence[str],
    agglomeration: Mapping[str, Any],
    metrics: Sequence[Any] | None,
    output: Path | None,
    *,
    independent: bool,
    compress: bool,
    as_json: bool,
    quiet: bool,
) -> int:
    """Agglomerate a mesh across ranks, measure and write, with the options of ``agglo run``.

    Raises
    ------
    AggloError
        On all ranks.
    """
    if len(bisectors) > 1:
        raise OptionError(
            f"{' and '.join(bisectors)}: on several ranks only one bisector can be used at a time"
        )
    from agglo_core.distributed import Ranks, write
    from agglo_core.distributed.files.writing import check_parallel_target
    from agglo_core.measure.selection import RATIOS

    ranks = Ranks()
    # Refuse bad output paths before any work.
    arguments = (
        {**agglomeration, "bisector": choice("bisector", bisectors[0])} if bisectors else agglomeration
    )
    with ranks.together():
        if output is not None:
            check_parallel_target(output)
            refuse_input(source, output)
    first = ranks.rank == 0
    # Read, warm up, agglomerate, measure and write on all ranks.
    with show_progress(quiet or not first) as progress:
        with phase(progress, "reading", source):
            mesh = read_shared_mesh(source, ranks)
        with phase(progress, "loading"):
            warm_up_in_turn(arguments, ranks)
        hierarchy, seconds, cpu = agglomerate_on_ranks(mesh, arguments, independent, progress)
        with phase(progress, "measuring"):
            _ = mesh.h  # computed by all ranks, reported by rank 0
            levels = _levels(hierarchy, RATIOS if metrics is None else metrics)
        if output is not None:
            with phase(progress, "writing", output.name):
                write(output, mesh, hierarchy, compress=compress)
    if first:
        name = bisectors[0] if bisectors else hierarchy.statistics["bisector"]
        _tell(source, mesh, _Run(name, hierarchy, levels, seconds, cpu), as_json=as_json, quiet=quiet)
        if output is not None and not (as_json or quiet):
            print_lines(f"wrote {output}")
    return 0


def read_shared_mesh(source: str, ranks: Ranks) -> DistributedMesh:
    """Read a distributed mesh: a ``.pvtu`` file on all ranks, any other file or a sample on rank 0."""
    from agglo_core.distributed import DistributedMesh, read

    if source.lower().endswith(".pvtu"):
        return read(source, ranks)
    with ranks.together():
        whole = load_mesh(source) if ranks.rank == 0 else None
    return DistributedMesh.scatter(whole, ranks)


def warm_up_in_turn(given: Mapping[str, Any], ranks: Ranks) -> None:
    """Compile the kernels on rank 0 first, so that the other ranks read them from the disk cache."""
    with ranks.together():
        try:
            if ranks.rank == 0:
                warm_up(given)
        finally:
            ranks.meet()
        if ranks.rank > 0:
            warm_up(given)


def agglomerate_on_ranks(
    mesh: DistributedMesh, given: Mapping[str, Any], independent: bool, progress: Any
) -> tuple[DistributedHierarchy, float, float]:
    """Agglomerate a distributed mesh.

    Returns the hierarchy, and the wall and CPU seconds of the slowest rank.
    """
    from agglo_core.agglomeration import Pipeline
    from agglo_core.agglomeration.one_call import replace_keywords
    from agglo_core.distributed import agglomerate

    with mesh.ranks.together():
        arguments = dict(given)
        config, trusted = arguments.pop("config", None), bool(arguments.pop("allow_code", False))
        base = Pipeline() if config is None else Pipeline.from_toml(config, allow_code=trusted)
        pipeline = replace_keywords(base, arguments)
    start, cpu_start = time.perf_counter(), time.process_time()
    hierarchy = agglomerate(mesh, pipeline, independent_of_ranks=independent or None, progress=progress)
    seconds, cpu_seconds = time.perf_counter() - start, time.process_time() - cpu_start
    return hierarchy, mesh.ranks.largest(seconds), mesh.ranks.largest(cpu_seconds)


def _levels(hierarchy: DistributedHierarchy, metrics: Sequence[Any]) -> list[_Level]:
    levels = []
    for place, target in enumerate(hierarchy.targets):
        values = hierarchy.quality(place, metrics)
        means = {name: None if math.isnan(value) else value for name, value in values.items()}
        names = [name for name in means if name not in ("connected", "max_diameter")]
        line = {"target": dict(target), "parts": hierarchy.parts[place], "diameter_ratio": None, **means}
        levels.append(_Level(target, line, names))
    return levels


def _tell(source: str, mesh: DistributedMesh, run: Any, *, as_json: bool, quiet: bool) -> None:
    """Print the results of ``agglo run`` with the rank count, as a table or as JSON."""
    name, size = mesh.local.name or source, mesh.ranks.size
    if as_json:
        levels = [level_data(level) for level in run.levels]
        run_record = {"bisector": run.name, "levels": levels, "seconds": run.seconds}
        whole = {"name": name, "cells": mesh.n_cells, "h0": mesh.h}
        print_json(
            {"mesh": whole, "ranks": size, "runs": [run_record | {"statistics": run.hierarchy.statistics}]}
        )
    elif not quiet:
        on = "1 rank" if size == 1 else f"{size} ranks"
        show(f"{name}: {mesh.n_cells:,} cells on {on}, h0 = {number(mesh.h)}", [run])
