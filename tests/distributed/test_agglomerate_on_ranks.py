"""Agglomeration on several ranks: what is promised on one machine holds across their borders."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from functools import cache
from itertools import pairwise
from typing import Any

import numpy as np
import pytest
from numpy.typing import NDArray
from on_ranks import on_ranks

import agglo_core as agglo
from agglo_core import Mesh, Pipeline, samples
from agglo_core.constraints.regions import Regions
from agglo_core.distributed import DistributedMesh, Ranks, agglomerate
from agglo_core.distributed.agglomeration import levels as distributed_levels
from agglo_core.distributed.agglomeration.part_components import component_sizes

Labels = list[NDArray[Any]]

CASES: dict[str, dict[str, Any]] = {
    "default": {},
    "default with regions": {"regions": "mat"},
    "sizes": {"h_factor": (2, 4, 8)},
    "counts down to one part": {"n_parts": (120, 24, 3, 1)},
    "few parts only": {"n_parts": 2},
    "few of a size": {"h_star": 0.5},
    "regions": {"regions": "mat", "n_parts": (120, 30, 6)},
    "barriers": {"barriers": "crack", "h_factor": (3, 9)},
    "where": {"where": "mat", "cells_per_part": (8, 40)},
    "ridges": {"boundary_rules": "ridges", "n_parts": (200, 60)},
    "bounds": {"max_cells": 14, "min_cells": 5, "n_parts": 120},
    "bounds of agglomerates": {"max_cells": 700, "n_parts": 3},
    "mean sizes": {"regions": "mat", "cells_per_part": (10, 100, 2000)},
    "mean sizes and bounds": {"max_cells": 60, "cells_per_part": (12, 500)},
    "weights bounded": {"weights": "load", "max_weight": 90, "min_weight": 20, "n_parts": 120},
    "weights joined": {"weights": "load", "min_weight": 60, "cells_per_part": 2},
    "stretched": {"metric": np.diag([1.0, 9.0]), "n_parts": (120, 12)},
    "k-way": {"method": "kway", "bisector": "metis", "n_parts": (120, 24)},
    "each level for itself": {"nested": False, "n_parts": (120, 24)},
    "merged": {"merge": True, "h_factor": (3, 6)},
    "inertial": {"bisector": "inertial", "h_factor": (2, 6)},
    "sweep": {"bisector": "sweep", "h_factor": (2, 6)},
    "gnn": {"bisector": "gnn", "h_factor": (2, 6)},
    "spectral": {"bisector": "spectral", "cells_per_part": (10, 100)},
}


def cracked() -> Mesh:
    """Voronoi cells of four materials, with a crack that ends inside."""
    mesh = samples.voronoi(1200, seed=5).with_tags(mat=lambda x: (x[:, 0] > 0.37) + 2 * (x[:, 1] > 0.61))
    mesh = mesh.with_tags(load=np.random.default_rng(2).integers(0, 10, mesh.n_cells))
    left = mesh.cell_centroids[:, 0] < 0.5
    sides = left[mesh.face_cells[:, 0]] != left[mesh.face_cells[:, 1]]
    middle = np.abs(mesh.face_centroids[:, 1] - 0.5) < 0.3
    return mesh.with_face_tags(
        crack=np.where(sides & middle & (mesh.face_cells[:, 1] >= 0), 1, -1),  # -1 as in files
        side=lambda x: (x[:, 0] < 1e-9) + 2 * (x[:, 1] < 1e-9) + 3 * (x[:, 0] > 1 - 1e-9),
    )


def shared(mesh: Mesh, ranks: Ranks | None = None) -> DistributedMesh:
    ranks = ranks or Ranks()
    return DistributedMesh.scatter(mesh if ranks.rank == 0 else None, ranks)


def labels_of(cases: Mapping[str, dict[str, Any]], independent: bool) -> dict[str, Labels]:
    """All labels of all cases, on rank 0."""
    mesh, found = shared(cracked()), {}
    for name, options in cases.items():
        made = agglomerate(mesh, Pipeline(**options), independent_of_ranks=independent, block_cells=200)
        found[name] = [mesh.gather(labels) for labels in made.levels]
        assert [int(made.components(k).max(initial=1)) for k in range(len(found[name]))] == [1] * len(
            found[name]
        )
    return found if mesh.ranks.rank == 0 else {}


@cache
def serial_targets(name: str) -> Sequence[Mapping[str, Any]]:
    """Targets of the levels of a case on one machine."""
    return agglo.agglomerate(cracked(), **CASES[name]).targets


def check_levels(mesh: Mesh, name: str, levels: Labels) -> None:
    """Parts are numbered without gaps, connected, as many or as small as asked, and nested."""
    for labels, target in zip(levels, serial_targets(name), strict=True):
        parts = int(labels.max()) + 1
        assert len(np.unique(labels)) == parts, name
        assert mesh.graph.components(labels).max() == parts - 1, name
        if name in ("mean sizes and bounds", "weights joined"):
            assert 20 <= parts < 120, name
        elif "n_parts" in target:
            assert parts == target["n_parts"], name
        else:
            wide = mesh.graph.part_diameters(labels) > target["h_star"] * (1 + 1e-9)
            assert (np.bincount(labels)[wide] == 1).all(), name
    if CASES[name].get("nested", True):
        for fine, coarse in pairwise(levels):
            assert len(np.unique(np.stack((fine, coarse)), axis=1)[0]) == fine.max() + 1, name


def check_rules(mesh: Mesh, found: Mapping[str, Labels]) -> None:
    """Constraints hold across ranks, and on levels made of agglomerates."""
    material = mesh.cell_tags["mat"]
    for labels in found["regions"]:
        assert len(np.unique(np.stack((labels, material)), axis=1)[0]) == labels.max() + 1
    assert found["barriers"][1].max() < 60  # the crack alone separates cells
    for labels in found["barriers"]:
        beside = labels[mesh.face_cells[mesh.face_tags["crack"] == 1]]
        assert (beside[:, 0] != beside[:, 1]).all()
    for labels in found["where"]:
        assert (np.bincount(labels)[labels[material == 0]] == 1).all()
    assert np.bincount(found["bounds"][0]).max() <= 14
    assert np.bincount(found["bounds"][0]).min() >= 5
    assert np.bincount(found["bounds of agglomerates"][0]).max() <= 700
    load = mesh.cell_tags["load"]
    assert np.bincount(found["weights bounded"][0], load).min() >= 20
    assert np.bincount(found["weights bounded"][0], load).max() <= 90
    assert np.bincount(found["weights joined"][0], load).min() >= 60
    assert [labels.max() + 1 for labels in found["mean sizes"]] == [120, 12, 4]
    for labels in found["mean sizes and bounds"]:
        assert np.bincount(labels).max() <= 60


def test_labels_can_be_independent_of_the_ranks() -> None:
    pytest.importorskip("mpi4py")
    alone = labels_of(CASES, True)  # first, as ranks that wait for a kernel use their cores
    mesh, found = cracked(), on_ranks(2, labels_of, CASES, True, seconds=300)[0]
    for name, levels in found.items():
        check_levels(mesh, name, levels)
        for one, other in zip(alone[name], levels, strict=True):
            np.testing.assert_array_equal(one, other, err_msg=name)
    check_rules(mesh, found)


def test_guarantees_of_one_process_hold_on_three_ranks() -> None:
    # A bisector splits the cells of one rank, as it does in the test above.
    cases = {name: how for name, how in CASES.items() if name not in ("inertial", "sweep", "gnn", "spectral")}
    mesh, found = cracked(), on_ranks(3, labels_of, cases, False, seconds=300)[0]
    for name, levels in found.items():
        check_levels(mesh, name, levels)
    check_rules(mesh, found)


def small_domains(cases: Mapping[str, dict[str, Any]], few: int) -> dict[str, Labels]:
    """The same where so many nodes of a domain are many: agglomerates are made before domains are joined."""
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(distributed_levels, "_FEW_NODES", few)
        return labels_of(cases, False)


def test_agglomerates_in_between_keep_sizes_and_counts() -> None:
    cases = {"few parts only": CASES["few parts only"], "few of a size": CASES["few of a size"]}
    found, mesh = on_ranks(3, small_domains, cases, 60)[0], cracked()
    for name, levels in found.items():
        check_levels(mesh, name, levels)


def test_one_rank_makes_the_levels_of_one_machine() -> None:
    pytest.importorskip("mpi4py")
    mesh = cracked()
    options: dict[str, Any] = {"n_parts": (120, 24), "regions": "mat"}
    made = agglomerate(shared(mesh), Pipeline(**options))
    for ours, theirs in zip(made.levels, agglo.agglomerate(mesh, **options).levels, strict=True):
        np.testing.assert_array_equal(ours, theirs)


def anywhere(
    mesh: Mesh, places: dict[str, NDArray[Any]], pipeline: Pipeline
) -> dict[str, tuple[Labels, NDArray[Any], dict[str, float]]]:
    """Labels, parents and quality of a mesh whose cells lie on the ranks of each of the ``places``."""
    whole, found = shared(mesh), {}
    for name, to in places.items():
        there = whole.redistributed(to[whole.global_ids[whole.own]])
        made = agglomerate(there, pipeline)
        levels = [np.asarray(there.gather(labels)) for labels in made.levels]
        parents = np.concatenate(there.ranks.gathered(made.parents(0)))
        injected = made.prolongation(0)
        assert injected.shape == (len(there.own), made.parts[0])
        assert np.array_equal(injected.indices, made.levels[0])
        found[name] = levels, parents, made.quality(0, ["UF", "CR", "CRc"])
    return found


def test_any_distribution_of_cells_is_agglomerated() -> None:
    mesh = samples.voronoi(900, seed=8)
    x = mesh.cell_centroids
    places = {
        "all on one rank": np.ones(len(x), np.int64),
        "one rank without cells": 2 * (x[:, 0] > 0.5),
        "scattered": np.random.default_rng(1).integers(0, 3, len(x)),
        "uneven": (x[:, 0] > 0.9).astype(int) + (x[:, 0] > 0.97),
    }
    answers = on_ranks(3, anywhere, mesh, places, Pipeline(n_parts=(90, 9)))
    for name in places:
        (fine, coarse), parents, quality = answers[0][name]
        assert all(each[name][2] == quality for each in answers)
        assert (fine.max() + 1, coarse.max() + 1) == (90, 9)
        np.testing.assert_array_equal(parents[fine], coarse)
        for metric, values in agglo.quality(mesh, fine, ["UF", "CR", "CRc"]).items():
            assert quality[metric] == pytest.approx(values.mean(), rel=1e-9)
        assert quality["connected"] == 1.0


def districts(people: NDArray[Any], size: str | None) -> list[Any]:
    """People of each part of both levels."""
    whole = shared(samples.voronoi(1200, seed=1))
    pipeline = Pipeline(
        n_parts=(60, 6),
        weights=people[whole.global_ids[whole.own]],
        post_refiners=(("balance", {"size": size}),),
    )
    made = agglomerate(whole, pipeline, independent_of_ranks=False)
    return [np.bincount(whole.gather(labels), people) for labels in made.levels]


@pytest.mark.parametrize("size", [None, "weights"])
def test_weights_given_to_a_run_are_evened_out(size: str | None) -> None:
    people = np.random.default_rng(0).lognormal(3.0, 1.0, 1200)
    coarse = on_ranks(2, districts, people, size)[0][1]
    assert coarse.max() < 1.15 * coarse.mean()


def refused(*cases: dict[str, Any]) -> list[str]:
    found = []
    for options in cases:
        with pytest.raises(agglo.AggloError) as error:
            agglomerate(shared(cracked()), Pipeline(**options))
        found.append(str(error.value))
    return found


def test_many_bodies_are_agglomerated_where_they_lie() -> None:
    """Bodies that are whole on a rank are not taken for pieces that a border has made."""
    bodies = samples.squares(80).with_tags(body=lambda x: (8 * x).astype(int) @ [8, 1])
    levels, moved = on_ranks(2, bytes_of_bodies, bodies)[0]
    assert levels.max() + 1 == 64
    assert len(np.unique(np.stack((levels, bodies.cell_tags["body"])), axis=1)[0]) == 64
    assert moved < 20_000  # numbers, not the cells of a rank


def bytes_of_bodies(mesh: Mesh) -> tuple[NDArray[Any], int]:
    whole = shared(mesh)
    made = agglomerate(whole, Pipeline(regions="body", h_star=0.18), independent_of_ranks=False)
    return whole.gather(made.levels[0]), made.statistics["bytes"]


class Moody:
    """A constraint that asks of whole parts what only it knows."""

    def admissible(self, graph: agglo.Graph, labels: NDArray[Any]) -> NDArray[Any]:
        return np.ones(int(labels.max()) + 1, bool)


def test_what_cannot_be_had_is_refused_on_all_ranks() -> None:
    weightless = {"max_weight": 3.0, "weights": "crowd"}
    for rank, (unknown, few, crowd) in enumerate(
        on_ranks(2, refused, {"regions": "rock"}, {"regions": "mat", "n_parts": 3}, weightless)
    ):
        assert unknown == "constraint 'regions': no cell tag is named 'rock'; there are mat, load"
        assert crowd == "weights: no cell tag is named 'crowd'; there are mat, load"
        assert few.startswith("rank 0: OptionError: too few parts, 3" if rank else "too few parts, 3")
        assert "the constraints (constraint 'regions')" in few
    assert "only bounds and barriers" in refused({"constraints": [Moody()]})[0]


def sizes_of_regions(mesh: Mesh, places: Sequence[NDArray[Any]]) -> list[list[int]]:
    """Cells of each component of a region, for cells that lie on the ranks of each of the ``places``."""
    whole, found = shared(mesh), []
    for to in places:
        there = whole.redistributed(to[whole.global_ids[whole.own]])
        found.append(sorted(component_sizes(there, Regions("region").forbidden(there.local.graph)).tolist()))
    return found


def test_components_across_ranks_have_the_sizes_of_one_machine() -> None:
    mesh = samples.disconnected(12)
    x = mesh.cell_centroids
    region = np.where(np.arange(mesh.n_cells) % 7 == 0, np.arange(mesh.n_cells), -1 - (x[:, 1] > 0.5))
    mesh = mesh.with_tags(region=region)
    places = [
        np.random.default_rng(1).integers(0, 3, len(x)),
        2 * (x[:, 0] > 0.5),  # one rank has no cells
        (3 * np.argsort(np.argsort(x[:, 1])) // len(x)),
        np.zeros(len(x), np.int64),
    ]
    graph = mesh.graph
    serial = np.bincount(graph.without_edges(Regions(values=region).forbidden(graph)).components())
    for answer in on_ranks(3, sizes_of_regions, mesh, places):
        assert answer == [sorted(serial.tolist())] * len(places)
