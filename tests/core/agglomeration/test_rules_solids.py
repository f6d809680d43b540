"""Rules for parts on solids as the field has them: layers with faults, a brain with its tissues."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest
from rule_checks import MODES

from agglo_core import agglomerate, samples
from agglo_core.errors import OptionError
from agglo_core.hierarchy import Hierarchy
from agglo_core.mesh import Mesh

SOLID_MODES = {name: mode for name, mode in MODES.items() if mode.get("bisector") != "gnn"}


@pytest.fixture(scope="module")
def ground() -> Mesh:
    return samples.layered(12)


@pytest.fixture(scope="module")
def head() -> Mesh:
    return samples.brain3d(9)


def mixed(hierarchy: Hierarchy, tag: np.ndarray) -> int:
    """Parts with cells of several values of a tag, at any level."""
    found = 0
    for labels in hierarchy.levels:
        values = {part: set(tag[labels == part]) for part in range(labels.max() + 1)}
        found += sum(len(each) > 1 for each in values.values())
    return found


def inside(hierarchy: Hierarchy, mesh: Mesh, marked: np.ndarray) -> int:
    """Marked faces between two cells of one part, at any level."""
    one, other = mesh.face_cells[marked].T
    return sum(int((labels[one] == labels[other]).sum()) for labels in hierarchy.levels)


def sides_of(mesh: Mesh) -> list[frozenset[int]]:
    """The sides of the block that each cell touches."""
    sides: list[set[int]] = [set() for _ in range(mesh.n_cells)]
    for (cell, neighbour), side in zip(mesh.face_cells, mesh.face_tags["side"], strict=True):
        if neighbour < 0:
            sides[cell].add(int(side))
    return [frozenset(each) for each in sides]


@pytest.mark.parametrize("mode", SOLID_MODES.values(), ids=SOLID_MODES)
def test_layers_and_faults(ground: Mesh, mode: dict[str, Any]) -> None:
    hierarchy = agglomerate(ground, h_factor=(2, 4), regions="material", barriers="fault", **mode)
    assert mixed(hierarchy, ground.cell_tags["material"]) == 0
    assert inside(hierarchy, ground, ground.face_tags["fault"] > 0) == 0
    for labels in hierarchy.levels:
        pieces = [ground.graph.subgraph(np.flatnonzero(labels == part), [0, count])
                  for part, count in enumerate(np.bincount(labels))]  # fmt: skip
        assert all(piece.components().max() == 0 for piece in pieces)
    assert hierarchy.parts[1] < ground.n_cells / 8


def test_without_rules_layers_are_mixed_and_faults_crossed(ground: Mesh) -> None:
    hierarchy = agglomerate(ground, cells_per_part=(6, 24))
    assert mixed(hierarchy, ground.cell_tags["material"]) > 20
    assert inside(hierarchy, ground, ground.face_tags["fault"] > 0) > 20


def test_a_single_fault_may_be_meant(ground: Mesh) -> None:
    fault = ground.face_tags["fault"]
    hierarchy = agglomerate(ground, cells_per_part=24, barriers="fault=1")
    assert inside(hierarchy, ground, fault == 1) == 0
    assert inside(hierarchy, ground, fault == 2) > 0


@pytest.mark.parametrize("mode", SOLID_MODES.values(), ids=SOLID_MODES)
def test_ridges_of_the_ground_are_kept(ground: Mesh, mode: dict[str, Any]) -> None:
    hierarchy = agglomerate(ground, h_factor=(2, 4), boundary_rules="ridges", **mode)
    sides = sides_of(ground)
    assert max(map(len, sides)) == 3
    for labels in hierarchy.levels:
        counts = np.bincount(labels)
        for cell, own in enumerate(sides):
            assert len(own) < 3 or counts[labels[cell]] == 1
        for part in range(labels.max() + 1):
            assert len({sides[cell] for cell in np.flatnonzero(labels == part)}) == 1
    assert hierarchy.parts[1] < ground.n_cells / 4


def test_materials_faults_and_ridges_together(ground: Mesh) -> None:
    rules = {"regions": "material", "barriers": "fault", "boundary_rules": "ridges", "max_cells": 16}
    hierarchy = agglomerate(ground, h_factor=(2, 4), **rules)
    sides = sides_of(ground)
    kinds = np.array([sum(1 << side for side in own) for own in sides])
    assert mixed(hierarchy, ground.cell_tags["material"]) == mixed(hierarchy, kinds) == 0
    assert inside(hierarchy, ground, ground.face_tags["fault"] > 0) == 0
    assert max(np.bincount(labels).max() for labels in hierarchy.levels) <= 16


@pytest.mark.parametrize("mode", SOLID_MODES.values(), ids=SOLID_MODES)
def test_tissues_share_no_part(head: Mesh, mode: dict[str, Any]) -> None:
    hierarchy = agglomerate(head, h_factor=(3, 6), regions="tissue", **mode)
    assert mixed(hierarchy, head.cell_tags["tissue"]) == 0
    assert hierarchy.parts[0] < head.n_cells / 5


def test_white_matter_alone(head: Mesh) -> None:
    hierarchy = agglomerate(head, h_factor=6, where="tissue=3")
    white = head.cell_tags["tissue"] == 3
    labels = hierarchy.levels[0]
    assert (np.bincount(labels)[labels[~white]] == 1).all()
    assert len(np.unique(labels[white])) < white.sum() / 10


def test_a_brain_has_no_patches(head: Mesh) -> None:
    with pytest.raises(OptionError, match="the mesh has no boundary patches"):
        agglomerate(head, h_factor=3, boundary_rules="ridges")
