"""PETSc on one rank: the solver against elimination and our own, options, matrices, a DOLFINx mesh."""

from __future__ import annotations

import subprocess
import sys

import numpy as np
import pytest

import agglo_core as agglo
import agglo_petsc
from agglo_core import multigrid
from agglo_core.errors import OptionError
from agglo_petsc.ksp.option_database import parse_options
from agglo_petsc.levels.labels import nested_aggregates
from agglo_petsc.levels.polynomials import exponents, monomial
from agglo_petsc.ranks.row_shares import row_share, usable_levels

STRAIGHT = {"bisector": "coordinate", "refiners": (), "polish": False}  # little to compile


def test_listing_loads_no_petsc():
    code = "import agglo_petsc, sys; agglo_petsc.agglo_components(); print('petsc4py' in sys.modules)"
    found = subprocess.run(
        [sys.executable, "-c", code], capture_output=True, text=True, check=True, timeout=60
    )
    assert found.stdout == "False\n"


def test_shares_cover_all_cells_once_and_keep_agglomerates_whole():
    mesh = agglo.samples.voronoi(200, seed=7)
    labels = agglo.agglomerate(mesh, cells_per_part=(5, 25), **STRAIGHT).levels
    shares = [row_share(labels, 200, rank, 3) for rank in range(3)]
    assert np.array_equal(np.concatenate([each.cells for each in shares]), shares[0].order)
    assert np.array_equal(np.sort(shares[0].order), np.arange(200))
    assert max(len(each.cells) for each in shares) < 100
    ids = np.concatenate([each.aggregates[0] for each in shares])
    found = np.empty(200, int)
    found[shares[0].order] = ids
    pairs = np.unique(np.stack((labels[0], found)), axis=1)
    assert pairs.shape[1] == labels[0].max() + 1  # one to one
    for level in (0, 1):
        own = [np.unique(each.aggregates[level]) for each in shares]
        assert np.array_equal(np.concatenate(own), np.arange(labels[level].max() + 1))


def test_each_patch_is_one_rank_s():
    mesh = agglo.samples.voronoi(150, seed=8)
    labels = agglo.agglomerate(mesh, cells_per_part=(6,), **STRAIGHT).levels
    whole = multigrid.vertex_patches(mesh)
    shares = [row_share(labels, 150, rank, 2) for rank in range(2)]
    own = [each.patches(0, whole) for each in shares]
    place = np.argsort(shares[0].order)
    wanted = sorted(sorted(place[each].tolist()) for each in np.split(whole.parts, whole.offsets[1:-1]))
    found = sorted(sorted(p.tolist()) for each in own for p in np.split(each.parts, each.offsets[1:-1]))
    assert found == wanted
    assert all(len(each) for each in own)


def test_levels_with_too_few_parts_for_the_ranks_are_left_out():
    labels = [np.arange(64) // 2, np.arange(64) // 8, np.arange(64) // 32]
    assert [len(usable_levels(labels, ranks)) for ranks in (1, 2, 8, 100)] == [3, 2, 1, 1]


def test_levels_that_are_not_nested_are_refused():
    with pytest.raises(OptionError, match="level 1 are not unions"):
        nested_aggregates([np.array([0, 0, 1, 1]), np.array([0, 1, 1, 1])])


def test_options_are_parsed_as_petsc_writes_them():
    assert parse_options("-a_b -1.5e3 -c -d 'x y'") == {"a_b": "-1.5e3", "c": "", "d": "x y"}
    for wrong in ("sor", "-a 1 2", 3, {"-1": 2}, {"a": [1]}):
        with pytest.raises(OptionError, match="petsc_options"):
            parse_options(wrong)


def test_unknowns_of_cells_get_nested_labels():
    levels = [np.array([0, 1, 1, 2]), np.array([0, 0, 0, 1])]
    rows = np.array([0, 1, 1, 2, 2, 3, 3, 4])
    fine, coarse = agglo_petsc.labels_of_unknowns(rows, np.repeat(np.arange(4), 2), levels, 5)
    assert fine.tolist() == [0, 0, 1, 1, 2]
    assert coarse.tolist() == [0, 0, 0, 0, 1]
    with pytest.raises(OptionError, match="1 are in no cell"):
        agglo_petsc.labels_of_unknowns(rows, np.repeat(np.arange(4), 2), levels, 6)


def test_monomials_span_all_polynomials_of_a_degree():
    points = np.random.default_rng(0).uniform(-1, 1, (40, 3))
    columns = np.stack([monomial(points, each) for each in exponents(3, 2)], axis=1)
    x, y, z = points.T
    quadratic = 3 * x * y - z**2 + x - 2
    assert columns.shape == (40, 10)
    assert abs(columns @ np.linalg.lstsq(columns, quadratic)[0] - quadratic).max() < 1e-12
