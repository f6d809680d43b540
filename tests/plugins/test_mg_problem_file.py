"""Problems by name and from TOML files."""

from __future__ import annotations

import logging
import re
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from agglo_core import FileError, Mesh, agglomerate, samples
from agglo_core.problems import named_problem, read_problem
from agglo_polydg_mg.paper.paper_multigrid import PaperMultigrid


@pytest.fixture
def mesh() -> Mesh:
    """Squares with a material on the left and on the right, and the boundary tagged by side."""
    plain = samples.squares(4)
    material = (plain.cell_centroids[:, 0] > 0.5).astype(int) + 1
    ends = plain.points[plain.face_pairs]
    sides = np.zeros(plain.n_faces, int)
    for tag, (axis, value) in enumerate([(0, 0.0), (0, 1.0), (1, 0.0), (1, 1.0)], 1):
        sides[(ends[:, :, axis] == value).all(axis=1)] = tag
    return replace(plain, cell_tags={"material": material}, face_tags={"boundary": sides})


def written(folder: Path, text: str) -> Path:
    path = folder / "problem.toml"
    path.write_text(text, encoding="utf-8")
    return path


def test_the_named_problems(mesh: Mesh) -> None:
    assert named_problem("constant", mesh).source == 8.0
    sine = named_problem("sine", mesh)
    assert sine.exact is not None
    assert callable(sine.source)
    centre = np.array([[0.5, 0.5]])
    assert sine.exact(centre) == pytest.approx(1.0)
    assert sine.source(centre) == pytest.approx(2 * np.pi**2)


def test_the_solution_is_unknown_on_another_domain(mesh: Mesh, caplog: pytest.LogCaptureFixture) -> None:
    moved = replace(mesh, points=mesh.points + 0.25)
    with caplog.at_level(logging.INFO, "agglo"):
        assert named_problem("sine", moved).exact is None
    assert "it is not the solution" in caplog.text


def test_numbers_by_cell_tag_and_boundary_tag(tmp_path: Path, mesh: Mesh) -> None:
    text = "source = 2\n[kappa.material]\n1 = 1.0\n2 = 1e6\n[dirichlet]\n1 = 0\n[neumann]\n4 = -1.5\n"
    problem = named_problem(str(written(tmp_path, text)), mesh)
    assert problem.source == 2.0
    assert np.array_equal(problem.kappa, np.where(mesh.cell_tags["material"] == 1, 1.0, 1e6))
    assert problem.dirichlet == {1: 0.0}
    assert problem.neumann == {4: -1.5}


def test_another_face_tag_may_hold_the_boundary(tmp_path: Path, mesh: Mesh) -> None:
    """As that of a file of gmsh: the problem says its name."""
    sides = mesh.face_tags["boundary"]
    named = replace(mesh, face_tags={"gmsh:physical": 10 * sides, "boundary": 0 * sides})
    text = 'boundary = "gmsh:physical"\nsource = 0\n[dirichlet]\n10 = 1.0\n20 = 3.0\n'
    problem = read_problem(written(tmp_path, text), named)
    assert problem.boundary == "gmsh:physical"
    assert problem.dirichlet == {10: 1.0, 20: 3.0}
    solution = PaperMultigrid(tolerance=1e-10).solve(problem, agglomerate(named, n_parts=4))
    exact = PaperMultigrid().discretisation.basis(named).project(lambda x: 1.0 + 2.0 * x[:, 0])
    assert solution.x == pytest.approx(exact, abs=1e-8)


def test_an_empty_file_is_the_default_problem(tmp_path: Path, mesh: Mesh) -> None:
    problem = read_problem(written(tmp_path, ""), mesh)
    assert (problem.kappa, problem.source, problem.dirichlet, problem.neumann) == (1.0, 1.0, {}, {})


@pytest.mark.parametrize(
    ("text", "message"),
    [
        (
            "f = 1",
            "unknown key 'f'; accepted: boundary, kappa, convection, reaction, source, dirichlet, neumann",
        ),
        ("kappa = [", "problem.toml: "),
        ("source = 'sin(x)'", "source must be a finite number, given 'sin"),
        ("source = 1e400", "source must be a finite number, given inf"),
        ("source = 1" + "0" * 400, "source must be a finite number, given 1000"),
        ("[neumann]\n1 = -inf", "neumann.1 must be a finite number, given -inf"),
        ("source = true", "source must be a finite number, given True"),
        ("kappa = nan", "kappa must be a finite number"),
        ("kappa = 0", "kappa must be positive, given 0"),
        ("[kappa.material]\n1 = 1.0\n2 = -3", "kappa must be positive, given -3"),
        ("[kappa.zone]\n1 = 1.0", "for a cell tag of the mesh; it has: material"),
        ("[kappa]\nmaterial = 1.0", "must be a table for a cell tag"),
        ("[kappa]", "kappa must name one cell tag, given none"),
        ("[source.material]\n1 = 1.0", "source.material has no number for 2"),
        (
            "[kappa.material]\n1 = 1\n2 = 1\n3 = 5",
            "kappa.material names 3; the tag's values in the mesh are: 1, 2",
        ),
        ("[source.material]\nleft = 1.0", "'left' must be a tag value"),
        ("dirichlet = 0", "by boundary tag, given 0: below a line [dirichlet]"),
        ("[dirichlet]\n7 = 0", "dirichlet names boundary tag 7; the mesh has: 1, 2, 3, 4 (it has the"),
        ("[dirichlet]\nleft = 0", "dirichlet: 'left' must be a tag value"),
        ("[dirichlet]\n1 = {}", "dirichlet.1 must be a finite number, given {}"),
        ("[dirichlet]\n1 = 0\n01 = 1", "dirichlet gives tag 1 twice"),
        ("[kappa.material]\n1 = 1\n01 = 1", "kappa.material gives tag 1 twice"),
        ("[dirichlet]", "[dirichlet] is empty: give a number for each boundary tag, or leave the table out"),
        ("[dirichlet]\n1 = 0\n[neumann]", "[neumann] is empty"),
        (
            "boundary = 'sides'",
            "boundary must be a face tag of the mesh, given 'sides'; it has the face tags: b",
        ),
        ("boundary = 1", "boundary must be a face tag of the mesh, given 1"),
        ("[dirichlet]\n1 = 0\n[neumann]\n1 = 0", "boundary tag 1 is in both dirichlet and neumann"),
    ],
)
def test_bad_files_are_refused(tmp_path: Path, mesh: Mesh, text: str, message: str) -> None:
    with pytest.raises(FileError, match=re.escape(message)):
        read_problem(written(tmp_path, text), mesh)


def test_a_folder_is_no_problem(tmp_path: Path, mesh: Mesh) -> None:
    with pytest.raises(
        FileError,
        match=r"a folder; a problem is a .toml file or a name \(constant, diff",
    ):
        named_problem(str(tmp_path), mesh)


def test_a_file_that_is_not_there_might_be_a_misspelt_name(mesh: Mesh) -> None:
    with pytest.raises(
        FileError,
        match=r"sinus: no such file, and no problem of that name \(constant, d",
    ):
        named_problem("sinus", mesh)
