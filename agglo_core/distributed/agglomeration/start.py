"""Start of a distributed run: agreement on constraints and targets, assignment of cells to domains."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np

from agglo_core.agglomeration import Pipeline
from agglo_core.agglomeration.goals import CountGoal, Goal
from agglo_core.arrays import Int, frozen_int
from agglo_core.constraints.metric import in_metric
from agglo_core.distributed.agglomeration.blocks_by_coordinates import (
    coordinate_blocks,
    halvings,
    rank_of_block,
)
from agglo_core.distributed.agglomeration.cells import Cells
from agglo_core.distributed.agglomeration.domain import Domain
from agglo_core.distributed.agglomeration.first_domains import first_domains
from agglo_core.distributed.agglomeration.part_components import component_sizes
from agglo_core.distributed.agglomeration.rules import Kept, evaluate_rules, with_ghosts
from agglo_core.distributed.agglomeration.stages import Return, Stage, move_pieces
from agglo_core.distributed.mesh.distributed_mesh import DistributedMesh
from agglo_core.registry import Registry


@dataclass(frozen=True, eq=False)
class Start:
    """Cells, constraints and targets of a run. Targets are equal on every rank."""

    mesh: DistributedMesh
    cells: Cells
    kept: Kept
    goals: Sequence[Goal]

    def begun(self, independent_of_ranks: bool | None, block_cells: int | None) -> Beginning:
        """Return the first domains: cell blocks by coordinates, or each rank's cells.

        With None, domains are blocks by coordinates if all cells already lie on their ranks.
        """
        if independent_of_ranks is False:
            return self.where_they_lie()
        ranks, mesh = self.cells.ranks, self.mesh
        depth = halvings(mesh.n_cells, mesh.local.dim, block_cells)
        block = coordinate_blocks(mesh.local.local_centroids[mesh.own], depth, ranks.reduced)
        misplaced = bool((rank_of_block(block, 1 << depth, ranks.size) != ranks.rank).any())
        in_place = not any(ranks.gathered(misplaced))
        if independent_of_ranks is None and not in_place:
            return self.where_they_lie()
        return self._in_blocks(frozen_int(mesh.exchange(block)), 1 << depth, there=in_place)

    def where_they_lie(self) -> Beginning:
        """Return one domain per rank: the cells owned by the rank."""
        ranks = self.cells.ranks
        with ranks.together():
            domains = first_domains(self.cells, self.kept, self.cells.owners, [ranks.rank])
        return Beginning(self.cells, Stage(ranks, ranks.size, dict(domains)), domains, None, in_blocks=False)

    def _in_blocks(self, block: Int, count: int, *, there: bool) -> Beginning:
        """Return the cell blocks ``(n,)`` as domains, and send each to its rank unless ``there`` already."""
        ranks, numbers = self.cells.ranks, frozen_int(np.arange(count))
        ours = np.flatnonzero(rank_of_block(numbers, count, ranks.size) == ranks.rank)
        with ranks.together():
            pieces = first_domains(self.cells, self.kept, block, ours.tolist())
        if there:
            return Beginning(self.cells, Stage(ranks, count, dict(pieces)), pieces, None, in_blocks=True)
        stage, way = move_pieces(ranks, pieces, count, lambda numbers: numbers)
        return Beginning(self.cells, stage, pieces, way, in_blocks=True)


@dataclass(frozen=True, eq=False)
class Beginning:
    """First domains of a run, with the transfer of their values back to each rank's cells.

    Attributes
    ----------
    cells : Cells
    stage : Stage
    pieces : sequence of (int, Domain)
        Own cells with domain numbers.
    way : Return or None
        Way back from domains to pieces, or None if these are equal.
    in_blocks : bool
        True if domains are blocks by coordinates.
    """

    cells: Cells
    stage: Stage
    pieces: Sequence[tuple[int, Domain]]
    way: Return | None
    in_blocks: bool

    def of_own_cells(self, values: Mapping[int, Int]) -> Int:
        """Return values on this rank's cells in id order, from ``values`` by domain."""
        way, ids = self.way, np.concatenate([piece.ids for _, piece in self.pieces])
        found = [values[number] for number, _ in self.pieces] if way is None else way.brought(values)
        return frozen_int(np.concatenate(found)[np.argsort(ids)])


def prepare_run(mesh: DistributedMesh, given: Pipeline, registry: Registry) -> Start:
    """Evaluate a run's constraints and targets, with the ``given`` components."""
    ranks, local = mesh.ranks, mesh.local
    pipeline = with_ghosts(given, mesh.exchange, len(mesh.own))
    with ranks.together():
        graph = local.graph if pipeline.metric is None else in_metric(local, local.graph, pipeline.metric)
    cells = Cells(ranks, graph, mesh.global_ids, mesh.owners)
    rules = evaluate_rules(cells, pipeline, local, registry)
    goals = _goals(mesh, pipeline, cells, rules)
    counts = isinstance(goals[0], CountGoal)
    with ranks.together():
        pipeline.mass(graph)  # may raise on a single rank
    balanced_graph = pipeline.balanced(graph, counts=counts, total=cells.total)
    return Start(mesh, replace(cells, graph=balanced_graph), rules, goals)


def _goals(mesh: DistributedMesh, pipeline: Pipeline, cells: Cells, rules: Kept) -> tuple[Goal, ...]:
    def mesh_size() -> float:
        if pipeline.metric is None:
            return mesh.h
        own_diameters = cells.graph.part_diameters(np.arange(cells.graph.n))[cells.own]
        return cells.ranks.largest(float(own_diameters.max(initial=0.0)))

    return pipeline.goals(mesh.n_cells, mesh_size, lambda: component_sizes(mesh, rules.forbidden))
