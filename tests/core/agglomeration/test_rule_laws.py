"""Rules for parts on random meshes, in every mode, with random tags, barriers, bounds; and mutants."""

from __future__ import annotations

import re
import sys

import numpy as np
import pytest
from hypothesis import Phase, assume, find, given, settings
from hypothesis.errors import NoSuchExample
from rule_checks import broken_promises, random_rules

import agglo_core as agglo
from agglo_core import Graph, OptionError
from agglo_core.agglomeration.levels import kway, polishing
from agglo_core.agglomeration.rules.members import Rules
from agglo_core.agglomeration.rules.parts import PartRules
from agglo_core.graph.ordering import curve_order


def made(mesh, options, rules):
    """The hierarchy, or None where the count asked for is refused by name."""
    try:
        return agglo.agglomerate(mesh, **options, **rules)
    except OptionError as error:
        if "n_parts" not in options or not re.match("too few parts|cannot find", str(error)):
            raise
        return None


def keeps_its_rules(drawn):
    mesh, options, rules = drawn
    hierarchy = made(mesh, options, rules)
    assume(hierarchy is not None)
    assert list(broken_promises(mesh, hierarchy, rules)) == []


@settings(max_examples=40)
@given(random_rules())
def test_rules_are_kept(drawn):
    keeps_its_rules(drawn)


@pytest.mark.slow
@settings(max_examples=150)
@given(random_rules())
def test_rules_are_kept_on_many_meshes(drawn):
    keeps_its_rules(drawn)


@settings(max_examples=25)
@given(random_rules())
def test_rules_that_ask_nothing_change_nothing(drawn):
    mesh, options, _ = drawn
    idle = {
        "regions": np.zeros(mesh.n_cells, int),
        "barriers": mesh.face_cells[:, 1] < 0,
        "where": np.ones(mesh.n_cells, bool),
        "max_cells": mesh.n_cells,
        "min_cells": 1,
        "max_measure": 2 * mesh.cell_measures.sum(),
        "max_weight": 2.0 * mesh.n_cells,
        "weights": np.ones(mesh.n_cells),
    }
    plain, bound = made(mesh, options, {}), made(mesh, options, idle)
    assume(plain is not None)
    for one, other in zip(plain.levels, bound.levels, strict=True):
        np.testing.assert_array_equal(one, other)


# --- mutants: each breaks one promise, and is found ---------------------------------------------------


def forgetful_merging(monkeypatch):
    """Merging on the whole graph, across regions and blocks."""
    forget(monkeypatch, "merge_parts")


def forgetful_polish(monkeypatch):
    """A polish of the whole graph, across regions and blocks."""
    forget(monkeypatch, "_polish")


def forget(monkeypatch, name):
    """Let a pass on finished levels work on the graph with all edges, as one block."""
    whole, real, members = {}, getattr(polishing, name), Rules.members

    def remembered(self, mesh, graph, registry):
        whole["graph"] = graph
        return members(self, mesh, graph, registry)

    def forgets(graph, blocks, *rest, **how):
        full = whole["graph"]
        if graph.n == full.n:
            graph, blocks = full.subgraph(curve_order(full.centroids), [0, full.n]), np.zeros_like(blocks)
        return real(graph, blocks, *rest, **how)

    monkeypatch.setattr(Rules, "members", remembered)
    monkeypatch.setattr(polishing, name, forgets)


def lost_tags(monkeypatch):
    """K-way levels above the finest that know all edges of the mesh."""
    real, whole, members = kway._one_level, {}, Rules.members

    def remembered(self, mesh, graph, registry):
        whole["graph"] = graph
        return members(self, mesh, graph, registry)

    def loses(graph, parts, goal, run, stage):
        known = real_coarsen(whole["fine"], whole["labels"]) if stage else graph
        return real(known if known.n == graph.n else graph, parts, goal, run, stage)

    def coarsen(self, labels):
        if sys._getframe(1).f_globals is vars(kway):  # others coarsen, too
            full = whole["graph"]
            whole["fine"], whole["labels"] = full.subgraph(curve_order(full.centroids), [0, full.n]), labels
        return real_coarsen(self, labels)

    real_coarsen = Graph.coarsen
    monkeypatch.setattr(Rules, "members", remembered)
    monkeypatch.setattr(kway, "_one_level", loses)
    monkeypatch.setattr(Graph, "coarsen", coarsen)


def rules_of_parts_skipped(monkeypatch):
    monkeypatch.setattr(PartRules, "kept", lambda self, graph, blocks, labels, *rest: labels)


def counts_lost(monkeypatch):
    from agglo_core.agglomeration.rules import parts

    monkeypatch.setattr(parts._Level, "to_count", lambda self, labels, count: labels)
    monkeypatch.setattr(parts._Level, "evened", lambda self, labels: labels)


MUTANTS = [forgetful_merging, forgetful_polish, lost_tags, rules_of_parts_skipped, counts_lost]


@pytest.mark.slow
@pytest.mark.parametrize("mutant", MUTANTS)
def test_mutants_are_found(monkeypatch, mutant):
    mutant(monkeypatch)

    def breaks(drawn):
        mesh, options, rules = drawn
        try:
            hierarchy = agglo.agglomerate(mesh, **options, **rules)
        except OptionError:
            return False
        except agglo.AggloError:
            return True
        return any(broken_promises(mesh, hierarchy, rules))

    search = settings(
        max_examples=400, deadline=None, database=None, phases=[Phase.generate]
    )  # do not shrink
    try:
        find(random_rules(), breaks, settings=search)
    except NoSuchExample:
        pytest.fail(f"{mutant.__name__} was not found")
