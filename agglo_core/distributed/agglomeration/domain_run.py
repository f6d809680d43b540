"""Levels of a single domain, built as on a mesh without ranks."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace

import numpy as np

from agglo_core.agglomeration import Pipeline
from agglo_core.agglomeration.goals import Goal
from agglo_core.agglomeration.levels.lines import line_levels
from agglo_core.agglomeration.levels.ordered import compute_levels
from agglo_core.agglomeration.levels.polishing import PostPass
from agglo_core.agglomeration.rules.edges import naming_constraints
from agglo_core.agglomeration.rules.parts import PartRules
from agglo_core.agglomeration.run import Run
from agglo_core.arrays import Int, UInt64, frozen_int, splitmix
from agglo_core.constraints.barriers import Barriers
from agglo_core.distributed.agglomeration.domain import Domain
from agglo_core.distributed.agglomeration.rules import Kept
from agglo_core.registry.attribution import Member


@dataclass(frozen=True)
class DomainRun:
    """Agglomeration of single domains with the components and constraints of a run.

    Attributes
    ----------
    pipeline : Pipeline
    run : Run
        Run with its components. Events are added to its statistics.
    kept : Kept
        Run constraints.
    """

    pipeline: Pipeline
    run: Run
    kept: Kept

    def levels(self, domain: Domain, goals: Sequence[Goal], number: int, turn: int) -> list[Int]:
        """Agglomerate one domain, and return the labels ``(n,)`` of each level.

        The seed depends on ``number`` and on ``turn``, the number of domain changes so far.
        """
        if domain.n == 0:
            return [frozen_int(np.empty(0))] * len(goals)
        kway = self.pipeline.method == "kway"
        run, post = self._seeded(number, turn), self._post(domain, self.kept.bounds)
        with naming_constraints(self.kept.members):
            make = self._maker(domain)
            return make(domain.by_itself(), goals, run, post, kway=kway, nested=self.pipeline.nested)

    def intermediate(self, domain: Domain, goal: Goal, number: int, turn: int) -> Int:
        """Agglomerate one domain to an auxiliary level without bounds on part sizes.

        Return the labels, from which larger domains are formed.
        """
        if domain.n == 0:
            return frozen_int(np.empty(0))
        run, post = self._seeded(number, turn), self._post(domain, ())
        return self._maker(domain)(domain.by_itself(), [goal], run, post, kway=False, nested=True)[0]

    def _maker(self, domain: Domain) -> Callable[..., list[Int]]:
        """Return the function that builds levels: by lines of strongly coupled cells, or without.

        Only cells are grouped by lines, because agglomerates already contain whole lines.
        """
        return line_levels if self.pipeline.lines and (domain.cells == 1).all() else compute_levels

    def _post(self, domain: Domain, bounds: Sequence[Member]) -> PostPass:
        members = domain.counted(bounds)
        if len(domain.barriers):
            members.append(Member(Barriers(domain.barriers), "constraint 'barriers'"))
        nodes = frozen_int(np.arange(domain.n))
        rules = PartRules(domain.graph, members, nodes) if members else None
        return PostPass(self.pipeline.merge, bool(self.run.post_refiners), rules)

    def _seeded(self, number: int, turn: int) -> Run:
        """Return the run with a seed that depends on the domain. The first domain has the run's seed."""
        if number == turn == 0:
            return self.run
        root: UInt64 = np.array([self.run.seed], np.uint64)
        mixed = splitmix(splitmix(root) + np.uint64((turn << 32) + number))
        return replace(self.run, seed=int(mixed[0] >> np.uint64(1)))
