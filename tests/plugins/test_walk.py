"""Loops over cells whose numbers are scattered: another order, the same matrix."""

from __future__ import annotations

import numpy as np

from agglo_core import samples
from agglo_core.problems import Diffusion
from agglo_polydg_mg.forms.assembly import discretise
from agglo_polydg_mg.space.basis import Basis
from agglo_polydg_mg.space.walk import walk_through

WIDTH = 4  # unknowns of a cell at degree 1


def test_scattered_numbers_change_nothing_but_the_numbers() -> None:
    rng, mesh = np.random.default_rng(20261123), samples.tetrahedra(8)
    cells = rng.permutation(mesh.n_cells)
    scattered = mesh.renumbered(cells)
    assert walk_through(mesh) is None
    assert walk_through(scattered) is not None
    kappa = rng.uniform(1.0, 9.0, mesh.n_cells)
    wanted = discretise(mesh, 1, Diffusion(kappa=kappa, source=1.0), penalty="sharp")
    found = discretise(scattered, 1, Diffusion(kappa=kappa[cells], source=1.0), penalty="sharp")
    rows = (WIDTH * cells[:, None] + np.arange(WIDTH)).ravel()
    apart = abs(found.A.tocsr() - wanted.A.tocsr()[rows][:, rows]).max()
    assert apart < 1e-12 * abs(wanted.A.data).max()
    np.testing.assert_allclose(found.b, wanted.b[rows], atol=1e-12 * abs(wanted.b).max())


def test_a_walk_visits_each_cell_once() -> None:
    mesh = samples.tetrahedra(8).renumbered(np.random.default_rng(1).permutation(3072))
    walk = Basis(mesh, 1).walk
    assert walk is not None
    assert sorted(walk.cells) == list(range(3072))
    offsets, faces = mesh.cell_faces
    ends, items = walk.rows(offsets, faces)
    for turn in (0, 7, 3071):
        own = walk.cells[turn]
        assert items[ends[turn] : ends[turn + 1]].tolist() == faces[offsets[own] : offsets[own + 1]].tolist()
    assert walk.turns[-1] == -1
    assert walk.back(walk.turns[walk.cells]).tolist() == walk.turns[:-1].tolist()
