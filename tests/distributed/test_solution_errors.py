"""Norms of errors, and what is on the boundary, do not depend on the number of ranks."""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path

import numpy as np
import pytest
from distributed.shared_meshes import shared
from on_ranks import on_ranks

from agglo_core import Mesh, samples
from agglo_core.distributed import error_norms, with_second_layer, write_solution
from agglo_core.errors import OptionError
from agglo_core.io.vtk.xml_read import parse
from agglo_core.problems import Diffusion, named_problem
from agglo_core.registry import default

WAVE = Diffusion(
    kappa=lambda x: 1.0 + x[:, 0],
    dirichlet={0: lambda x: 2.0 + x[:, 0]},
    exact=lambda x: np.cos(2.0 * x).prod(axis=1),
)


def meshes() -> Iterator[Mesh]:
    """In the plane, with runs of edges between two cells, and in space."""
    fine = samples.voronoi(150, seed=6)
    yield fine
    boxes = np.floor(5.0 * fine.cell_centroids).astype(int) @ [1, 5]
    yield fine.coarsen(np.unique(boxes, return_inverse=True)[1])
    yield samples.boxes(4)
    yield samples.tetrahedra(2)


def compare() -> None:
    """On ranks and in one process: of unknowns that are no solution, so that all terms count.

    The degree is 2 in the plane, 1 in space.
    """
    for mesh in meshes():
        whole = shared(mesh)
        wide, _ = with_second_layer(whole)
        ends = np.ptp(mesh.points, axis=0) + mesh.points.min(axis=0)
        middles = wide.face_centroids
        at_end = np.isclose(middles, ends).any(axis=1) | np.isclose(middles, mesh.points.min(axis=0)).any(
            axis=1
        )
        assert np.array_equal(wide.outer_faces, at_end)
        assert wide.n_cells == mesh.n_cells or (wide.face_cells[:, 1] < 0).sum() > at_end.sum()
        assert not (whole.local.outer_faces & whole.hidden).any()
        for penalty, problem in (("sharp", named_problem("sine", wide)), ("paper", WAVE)):
            how = default().build("discretisation", "polydg", degree=4 - mesh.dim, penalty=penalty)
            x = how.project(mesh, lambda points: np.exp(points[:, 0]) + points[:, 1] ** 3)
            told = how.errors(problem, mesh, x)
            mine = x.reshape(mesh.n_cells, -1)[whole.global_ids[whole.own]]
            found = error_norms(whole, problem, how, mine.ravel())
            assert told.keys() == found.keys() == {"l2", "dg"}
            for name, norm in told.items():
                assert found[name] == pytest.approx(norm, rel=1e-10), (mesh, name)
    assert error_norms(whole, Diffusion(), how, mine.ravel()) == {}
    with pytest.raises(OptionError, match="x has shape"):
        error_norms(whole, WAVE, how, mine.ravel()[:-1])


@pytest.mark.parametrize("size", [pytest.param(2, marks=pytest.mark.slow), 3])
def test_norms_and_boundary_are_those_of_the_whole_mesh(size: int) -> None:
    on_ranks(size, compare, seconds=120)


def write_slopes(path: str) -> None:
    """Write the function x² + y² on ranks, and compare the gradients in each piece with its centroids."""
    mesh = samples.voronoi(60, seed=3)
    whole, how = shared(mesh), default().build("discretisation", "polydg", degree=2)
    x = how.project(mesh, lambda points: (points**2).sum(axis=1))
    own = x.reshape(mesh.n_cells, -1)[whole.global_ids[whole.own]]
    write_solution(path, whole, how, own.ravel())
    piece = Path(path).with_suffix("") / f"{Path(path).stem}_{whole.ranks.rank}.vtu"
    document = parse(piece.read_bytes())
    found = {each.get("Name"): document.array(each, 1 << 20) for each in document.root.iter("DataArray")}
    corners = found["Points"].reshape(-1, 3)[found["connectivity"].reshape(-1, 3)]
    np.testing.assert_allclose(found["gradient"].reshape(-1, 3), 2.0 * corners.mean(axis=1), atol=1e-9)


def test_each_piece_of_a_solution_has_the_gradients_of_its_cells(tmp_path: Path) -> None:
    on_ranks(2, write_slopes, str(tmp_path / "u.pvtu"), seconds=120)


def test_what_is_not_on_the_boundary_is_not_looked_at() -> None:
    square = samples.squares(4)
    slope = Diffusion(exact=lambda x: x[:, 0])
    assert slope.posed_on(square).exact is None
    square.__dict__["outer_faces"] = np.zeros(square.n_faces, bool)  # as on a rank that is all inside
    assert slope.posed_on(square) is slope
