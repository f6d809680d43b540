"""Where a distributed run starts: rules and goals agreed upon, cells shared out among domains."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np

from agglo_core.agglomeration import Pipeline
from agglo_core.agglomeration.goals import CountGoal, Goal
from agglo_core.agglomeration.stretching import in_metric
from agglo_core.arrays import Int, frozen_int
from agglo_core.distributed.blocks_by_coordinates import coordinate_blocks
from agglo_core.distributed.cells import Cells
from agglo_core.distributed.distributed_mesh import DistributedMesh
from agglo_core.distributed.distributed_rules import Kept, kept_rules, with_ghosts
from agglo_core.distributed.first_domains import first_domains
from agglo_core.distributed.stages import Return, Stage, moved
from agglo_core.errors import OptionError
from agglo_core.registry import Registry

__all__ = ["Beginning", "Start", "started"]


@dataclass(frozen=True, eq=False)
class Start:
    """Cells, rules and goals of a run, the same goals on every rank."""

    mesh: DistributedMesh
    cells: Cells
    kept: Kept
    goals: Sequence[Goal]

    def where_they_lie(self) -> Beginning:
        """Each rank has one domain: its cells."""
        ranks = self.cells.ranks
        with ranks.together():
            domains = first_domains(self.cells, self.kept, self.cells.owners, [ranks.rank])
        return Beginning(self.cells, Stage(ranks, ranks.size, dict(domains)), None, [])

    def in_blocks(self, block_cells: int) -> Beginning:
        """Domains are blocks by coordinates, whatever the rank of their cells."""
        if not block_cells >= 1:
            raise OptionError(f"block_cells must be at least 1, given {block_cells!r}")
        cells, ranks = self.cells, self.cells.ranks
        depth = max(0, int(np.ceil(np.log2(self.mesh.n_cells / block_cells))))
        own = cells.graph.centroids[cells.own]
        block = frozen_int(self.mesh.exchange(coordinate_blocks(ranks, own, depth)))
        count = 1 << depth
        with ranks.together():
            numbers = np.arange(count)
            ours = numbers[numbers * ranks.size // count == ranks.rank].tolist()
            pieces = first_domains(cells, self.kept, block, ours)
        stage, way = moved(ranks, pieces, count, lambda numbers: numbers)
        return Beginning(cells, stage, way, [piece.ids for _, piece in pieces])


@dataclass(frozen=True, eq=False)
class Beginning:
    """The first domains, and the way back from them to the cells of each rank."""

    cells: Cells
    stage: Stage
    way: Return | None
    pieces: Sequence[Int]

    def of_own_cells(self, values: Mapping[int, Int]) -> Int:
        """Values of the own cells of this rank, in the order of their ids; ``values`` are by own domain."""
        if self.way is None:
            return values[self.cells.ranks.rank]
        ids = np.concatenate(self.pieces)
        found = np.empty(len(ids), np.int64)
        found[np.argsort(np.argsort(ids))] = np.concatenate(self.way.brought(values))
        return frozen_int(found)


def started(mesh: DistributedMesh, given: Pipeline, registry: Registry) -> Start:
    """The start of a run of ``given`` components and rules."""
    ranks, local = mesh.ranks, mesh.local
    pipeline = with_ghosts(given, mesh.exchange, len(mesh.own))
    with ranks.together():
        there = local.graph if pipeline.metric is None else in_metric(local, local.graph, pipeline.metric)
    cells = Cells(ranks, there, mesh.global_ids, mesh.owners)
    kept = kept_rules(cells, pipeline, local, registry)
    goals = _goals(mesh, pipeline, cells, kept)
    counts = isinstance(goals[0], CountGoal)
    with ranks.together():
        pipeline.mass(there)  # may refuse the weights of one rank
    masses = pipeline.balanced(there, counts=counts, total=cells.total)
    return Start(mesh, replace(cells, graph=masses), kept, goals)


def _goals(mesh: DistributedMesh, pipeline: Pipeline, cells: Cells, kept: Kept) -> tuple[Goal, ...]:
    neighbours = np.bincount(cells.rows, minlength=cells.graph.n)
    barred = np.bincount(cells.rows, kept.forbidden, cells.graph.n)
    alone = int(np.count_nonzero(cells.own & (neighbours > 0) & (neighbours == barred)))

    def mesh_size() -> float:
        if pipeline.metric is None:
            return mesh.h
        own = cells.graph.part_diameters(np.arange(cells.graph.n))[cells.own]
        return cells.ranks.largest(float(own.max(initial=0.0)))

    return pipeline.goals(mesh.n_cells, mesh_size, int(cells.ranks.summed(alone)))
