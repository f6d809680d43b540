"""Problems by tag fit every rank, also one that has no cell or face of a tag."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
import pytest
from distributed.shared_meshes import shared
from on_ranks import on_ranks

from agglo_core import Mesh, samples
from agglo_core.distributed import with_second_layer
from agglo_core.distributed.agglomeration.part_components import first_cells
from agglo_core.errors import OptionError
from agglo_core.mesh.tagging import distinct
from agglo_core.problems import Diffusion
from agglo_polydg_mg.forms.boundary import boundary_faces

TABLE: dict[str, Any] = {
    "kappa": {"rock": {"1": 1.0, "sand": 5.0}},
    "dirichlet": {"left": 2.0},
    "neumann": {"2": 1.0},
}


def tagged(mesh: Mesh) -> Mesh:
    """Faces 1 at the left, 2 at the right, else 0; cells 2 in a corner; a number for each cell."""
    ends = mesh.points[:, 0].min(), mesh.points[:, 0].max()
    return mesh.with_tags(
        rock=lambda x: 1 + (x.mean(axis=1) < 0.25),
        sand=lambda x: x.mean(axis=1) < 0.25,
        number=np.arange(mesh.n_cells),
    ).with_face_tags(
        boundary=lambda x: np.isclose(x[:, 0], ends[0]) + 2 * np.isclose(x[:, 0], ends[1]),
        left=lambda x: np.isclose(x[:, 0], ends[0]),
    )


def rows(columns: list[np.ndarray]) -> set[tuple[int, ...]]:
    return set(zip(*(each.tolist() for each in columns), strict=True))


def compare() -> None:
    """Kinds, components, tables and refusals: those of one process."""
    for mesh in (tagged(samples.squares(12)), tagged(samples.tetrahedra(3)), samples.disconnected(5)):
        whole = shared(mesh)
        part, _ = with_second_layer(whole)
        components = mesh.graph.components()
        first = np.unique(components, return_index=True)[1][components]
        assert np.array_equal(first_cells(whole), first[whole.global_ids[whole.own]])
        assert rows(list(part.cell_kinds.values())) == rows(list(mesh.cell_kinds.values()))
        told, known = part.boundary_kinds, mesh.boundary_kinds
        assert list(told.tags) == list(known.tags)
        assert rows([told.component, *told.tags.values()]) == rows([known.component, *known.tags.values()])
        if not mesh.cell_tags:
            continue
        posed = Diffusion.from_table(TABLE, part, Path())
        assert posed.dirichlet == {1: 2.0}
        assert np.array_equal(posed.kappa, np.where(part.cell_tags["rock"] == 2, 5.0, 1.0))
        faces = boundary_faces(part, posed)
        assert (faces.tags[faces.dirichlet] == 1).all()
        for wrong, text in (
            (
                {"kappa": {"rock": {"1": 1.0, "2": 1.0, "3": 1.0}}},
                "names 3; the tag's values in the mesh are: 1, 2",
            ),
            ({"dirichlet": {"3": 1.0}}, "names boundary tag 3; the mesh has: 0, 1, 2"),
        ):
            with pytest.raises(OptionError, match=text):
                Diffusion.from_table(wrong, part, Path())
        with pytest.raises(OptionError, match="component of cell 0 has no"):
            boundary_faces(part, Diffusion(neumann={2: 1.0}))


@pytest.mark.parametrize("size", [1, 3])
def test_problems_by_tag_are_those_of_the_whole_mesh(size: int) -> None:
    on_ranks(size, compare, seconds=120)


def test_a_table_of_too_many_values_is_refused(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("agglo_core.distributed.solution.kinds_of_all._MOST", 10)
    part, _ = with_second_layer(shared(tagged(samples.squares(4))))
    with pytest.raises(OptionError, match=r"kappa\.number: the tag has too many values"):
        Diffusion.from_table({"kappa": {"number": {"1": 1.0}}}, part, Path())


def test_distinct_rows() -> None:
    rng = np.random.default_rng(0)
    columns = [rng.integers(-3, 3, 200) for _ in range(3)]
    found = distinct(columns)
    assert rows(found) == rows(columns)
    assert len(found[0]) == len(rows(columns))
    assert distinct([]) == []
