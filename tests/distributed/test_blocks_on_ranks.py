"""Blocks by coordinates: cells are shared out by them, and labels are the same on any number of ranks."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest
from numpy.typing import NDArray
from on_ranks import on_ranks

from agglo_core import Mesh, OptionError, Pipeline, samples
from agglo_core.distributed import DistributedMesh, Ranks, agglomerate
from agglo_core.distributed.agglomeration.blocks_by_coordinates import coordinate_blocks

BLOCK = 200
CASES: dict[str, dict[str, Any]] = {
    "counts down to one part": {"n_parts": (150, 30, 3, 1)},
    "barriers": {"barriers": "crack", "h_factor": (3, 9)},
}
"""Others are compared on two ranks, in test_agglomerate_on_ranks."""


def halved(points: NDArray[Any], depth: int) -> NDArray[Any]:
    """Blocks, one by one, each cut at the first of all places that leave its halves as equal as can be."""
    block = np.zeros(len(points), np.int64)
    for _ in range(depth):
        finer = 2 * block
        for each in np.unique(block):
            inside = np.flatnonzero(block == each)
            along = points[inside, np.argmax(np.ptp(points[inside], axis=0))]
            cuts = np.unique(along)
            uneven = [abs(2 * np.count_nonzero(along <= cut) - len(along)) for cut in cuts]
            finer[inside] += along > cuts[np.argmin(uneven)]
        block = finer
    return block


POINTS = {
    "plane": np.random.default_rng(1).random((900, 2)),
    "solid, clustered": np.random.default_rng(2).random((700, 3)) ** 4 - 5.0,
    "many at one place": np.random.default_rng(3).integers(0, 17, (900, 2)).astype(np.float64),
    "all at one place": np.ones((5, 2)),
    "on a line": np.stack((np.zeros(300), np.random.default_rng(4).standard_normal(300)), axis=1),
}


@pytest.mark.parametrize("name", POINTS)
@pytest.mark.parametrize("depth", [0, 1, 6])
def test_blocks_are_those_of_halving_one_by_one(name: str, depth: int) -> None:
    points = POINTS[name]
    np.testing.assert_array_equal(coordinate_blocks(points, depth), halved(points, depth))


def test_many_blocks_are_found_in_the_same_way() -> None:
    """A block may have one point, or none."""
    points = np.random.default_rng(5).random((3000, 2))
    np.testing.assert_array_equal(coordinate_blocks(points, 11), halved(points, 11))


def test_cells_in_a_row_stay_together() -> None:
    """Rounding makes their coordinates differ, by less than what is looked at."""
    noise = 1e-13 * np.random.default_rng(6).standard_normal((625, 2))
    x = np.stack((np.arange(625) % 25, np.arange(625) // 25 * 0.9), axis=1)
    np.testing.assert_array_equal(coordinate_blocks(x + noise, 5), halved(x, 5))


def cracked() -> Mesh:
    mesh = samples.voronoi(1500, seed=15).with_tags(mat=lambda x: (x[:, 0] > 0.37) + 2 * (x[:, 1] > 0.61))
    left = mesh.cell_centroids[:, 0] < 0.5
    sides = left[mesh.face_cells[:, 0]] != left[mesh.face_cells[:, 1]]
    middle = np.abs(mesh.face_centroids[:, 1] - 0.5) < 0.3
    return mesh.with_face_tags(crack=sides & middle & (mesh.face_cells[:, 1] >= 0))


def shared(mesh: Mesh, method: str = "coordinates") -> DistributedMesh:
    ranks = Ranks()
    return DistributedMesh.scatter(mesh if ranks.rank == 0 else None, ranks, method, block_cells=BLOCK)


def labelled(mesh: DistributedMesh, options: dict[str, Any], independent: bool | None) -> Any:
    """Labels of all cells, whether they are of blocks, and what each rank has sent."""
    pipeline = Pipeline(**options)
    made = agglomerate(mesh, pipeline, independent_of_ranks=independent, block_cells=BLOCK)
    told = made.statistics
    return [mesh.gather(each) for each in made.levels], told["independent_of_ranks"], told["bytes"]


def by_default() -> dict[str, Any]:
    mesh = shared(cracked())
    mesh.check()
    share = len(mesh.own) * mesh.ranks.size / mesh.n_cells
    return {name: labelled(mesh, options, None) for name, options in CASES.items()} | {"share": share}


def test_labels_of_a_mesh_shared_out_do_not_depend_on_the_ranks() -> None:
    """Bit by bit; the parts are connected, and no rank has many more cells than the others."""
    mesh, alone, every = cracked(), by_default(), on_ranks(3, by_default, seconds=100.0)
    assert max(found["share"] for found in every) <= 1.2
    for name in CASES:
        levels, in_blocks, _ = every[0][name]
        assert in_blocks
        for one, other in zip(alone[name][0], levels, strict=True):
            np.testing.assert_array_equal(one, other, err_msg=name)
            assert mesh.graph.components(other).max() == other.max(), name


def in_several_ways() -> dict[Any, Any]:
    """Along a curve, that is with blocks in pieces: by default, where cells lie, sent to one rank each."""
    split, whole = shared(cracked(), "curve"), shared(cracked())
    options = CASES["barriers"]
    ways = {how: labelled(split, options, how) for how in (None, False, True)}
    last = split.redistributed(np.full(len(split.own), split.ranks.size - 1))  # others have no cells
    ways["last"] = labelled(last, options, True)
    return ways | {"whole": [labelled(whole, options, how) for how in (None, True, False)]}


def test_blocks_in_pieces_are_agglomerated_in_place_by_default() -> None:
    found = on_ranks(3, in_several_ways, seconds=100.0)[0]
    (default, told, _), (lying, _, _), (asked, independent, sent) = found[None], found[False], found[True]
    assert (told, independent) == (False, True)
    for one, other in zip(default, lying, strict=True):
        np.testing.assert_array_equal(one, other)
    (given, _, _), (moved, _, less), (ranked, kept, _) = found["whole"]
    assert less < sent  # no cells
    assert not kept
    for levels in (asked, moved, found["last"][0]):
        for one, other in zip(given, levels, strict=True):
            np.testing.assert_array_equal(one, other)
    assert any((one != other).any() for one, other in zip(given, ranked, strict=True))


def shares() -> list[float]:
    """Largest share over the mean, of meshes of few and of many blocks."""
    ranks, found = Ranks(), []
    for n in (10, 400, 700, 5000):
        whole = samples.voronoi(n, seed=n) if ranks.rank == 0 else None
        mesh = DistributedMesh.scatter(whole, ranks, block_cells=100)
        found.append(ranks.largest(len(mesh.own)) * ranks.size / n)
    return found


def test_no_rank_has_many_more_cells_than_the_others() -> None:
    few, four, some, many = on_ranks(3, shares)[0]
    assert few == pytest.approx(1.2)  # 4 cells of 10
    assert four == pytest.approx(1.5)  # 2 blocks of 4
    assert some == pytest.approx(1.125, abs=0.01)  # 3 blocks of 8
    assert many == pytest.approx(22 / 64 * 3, abs=0.01)


def test_blocks_of_no_cells_are_refused() -> None:
    pytest.importorskip("mpi4py")
    for block_cells in (0, -3, float("nan")):
        with pytest.raises(OptionError, match="block_cells must be at least 1"):
            DistributedMesh.scatter(samples.squares(2), block_cells=block_cells)  # type: ignore[arg-type]
        mesh = DistributedMesh.scatter(samples.squares(2))
        with pytest.raises(OptionError, match="block_cells must be at least 1"):
            agglomerate(mesh, Pipeline(n_parts=2), block_cells=block_cells)  # type: ignore[arg-type]
