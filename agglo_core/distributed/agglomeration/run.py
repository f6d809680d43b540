""":func:`agglomerate` across ranks: from a distributed mesh to its coarse levels."""

from __future__ import annotations

from dataclasses import asdict, fields, replace

from agglo_core.agglomeration import Pipeline
from agglo_core.agglomeration.choices import new_run, short_name
from agglo_core.agglomeration.levels.recursion import note_repeated_levels, warn_of_large_cells
from agglo_core.agglomeration.run import Run, Statistics
from agglo_core.distributed.agglomeration.domain_run import DomainRun
from agglo_core.distributed.agglomeration.hierarchy import DistributedHierarchy
from agglo_core.distributed.agglomeration.levels import build_levels
from agglo_core.distributed.agglomeration.start import prepare_run
from agglo_core.distributed.communication import Ranks
from agglo_core.distributed.mesh.distributed_mesh import DistributedMesh
from agglo_core.progress import Listener, followed, phase
from agglo_core.registry import Registry, default
from agglo_core.threads import using_threads


def agglomerate(
    mesh: DistributedMesh,
    pipeline: Pipeline | None = None,
    *,
    independent_of_ranks: bool | None = None,
    block_cells: int | None = None,
    registry: Registry | None = None,
    progress: Listener | None = None,
    verbose: bool = False,
    threads: int | None = None,
) -> DistributedHierarchy:
    """Agglomerate a distributed mesh. Collective, with equal arguments on all ranks.

    Cells are agglomerated in blocks by coordinates if each block lies on one rank, as after
    :meth:`DistributedMesh.scatter`. Then labels are equal for any number of ranks, including one. Otherwise
    each rank agglomerates its own cells. Counts are distributed with one exchange. Levels with few parts are
    built from the agglomerates of a finer level, if necessary on fewer ranks, so that parts grow across the
    block and rank borders.

    Parameters
    ----------
    mesh : DistributedMesh
    pipeline : Pipeline, optional
        Components, targets and rules, as on one process. Arrays hold a value per own cell (``barriers``:
        per face of ``mesh.local``). Cell lines end at rank borders.
    independent_of_ranks : bool, optional
        Require labels independent of the number of ranks: True sends each block's cells to one
        rank if necessary, False lets each rank agglomerate its own cells. Default: blocks if nothing has
        to be sent. ``statistics["independent_of_ranks"]`` reports the outcome.
    block_cells : int, optional
        Approximate maximum number of cells per block, as for :meth:`DistributedMesh.scatter`. Default:
        16,384 in 2-D, 131,072 in 3-D.
    registry, progress, verbose, threads : optional
        As for :func:`agglo_core.agglomerate`. Only rank 0 reports progress.

    Returns
    -------
    DistributedHierarchy
        Every part is connected, with sizes and counts as on one process.

    Raises
    ------
    OptionError, PluginError, RankError
        As on one process. A failure on one rank is a failure on all ranks.

    Examples
    --------
    >>> from agglo_core import Pipeline, distributed, samples
    >>> mesh = distributed.DistributedMesh.scatter(samples.squares(16))
    >>> distributed.agglomerate(mesh, Pipeline(n_parts=(16, 4))).parts
    [16, 4]
    """
    options = Pipeline() if pipeline is None else pipeline
    # Only the first rank reports progress.
    active_registry, ranks = default() if registry is None else registry, mesh.ranks
    before = replace(ranks.traffic)
    is_first = ranks.rank == 0
    with followed(progress if is_first else None, verbose and is_first) as listen, using_threads(threads):
        start = prepare_run(mesh, options, active_registry)
        beginning = start.begun(independent_of_ranks, block_cells)
        with ranks.together():
            run = new_run(options, active_registry)
        with phase(listen, "agglomerating") as notify:
            ranks.since_last()
            levels = build_levels(
                beginning.stage, start.goals, DomainRun(options, run, start.kept), notify=notify
            )
        labels = [beginning.of_own_cells(level.ids) for level in levels]
    # Collect statistics of all ranks.
    statistics, parts = _of_all_ranks(ranks, run), [level.numbering.parts for level in levels]
    if is_first:
        warn_of_large_cells(start.goals, replace(run, statistics=statistics))
        note_repeated_levels(start.goals, parts)
    return DistributedHierarchy(
        mesh,
        labels,
        [level.numbering.bounds for level in levels],
        [goal.record(count) for goal, count in zip(start.goals, parts, strict=True)],
        options.nested or len(levels) == 1,
        asdict(statistics)
        | {"bisector": short_name(options.bisector), "method": options.method}
        | {"independent_of_ranks": beginning.in_blocks}
        | {"messages": ranks.traffic.messages - before.messages, "bytes": ranks.traffic.bytes - before.bytes}
        | {"sent_by_level": [asdict(level.sent) for level in levels]},
    )


def _of_all_ranks(ranks: Ranks, run: Run) -> Statistics:
    """Combine all ranks' statistics: summed counts, largest depth, and largest time per phase."""
    every = ranks.gathered(run.statistics)
    total = Statistics()
    for name in (entry.name for entry in fields(Statistics) if entry.name != "seconds"):
        values = [getattr(entry, name) for entry in every]
        setattr(total, name, max(values) if name == "depth" else sum(values))
    for name in dict.fromkeys(name for entry in every for name in entry.seconds):
        total.seconds[name] = max(entry.seconds.get(name, 0.0) for entry in every)
    return total
