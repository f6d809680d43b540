"""Tags made from functions of centroids and from arrays."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from agglo_core import Mesh, agglomerate, read, samples, write
from agglo_core.errors import MeshError


def test_a_function_of_the_centroids_tags_cells() -> None:
    mesh = samples.squares(4)
    tagged = mesh.with_tags(left=lambda x: x[:, 0] < 0.5, row=lambda x: (4 * x[:, 1]).astype(np.int8))
    x, y = mesh.cell_centroids.T
    assert tagged.cell_tags["left"].tolist() == [1 if a < 0.5 else 0 for a in x]
    assert tagged.cell_tags["row"].tolist() == [int(4 * b) for b in y]
    assert all(tag.dtype == np.int64 and not tag.flags.writeable for tag in tagged.cell_tags.values())
    assert mesh.cell_tags == {}


def test_arrays_serve_and_are_copied() -> None:
    mesh, own = samples.squares(2), np.array([3, 1, 4, 1])
    tagged = mesh.with_tags(own=own, yes=[True, False, False, True])
    own[:] = 0
    assert tagged.cell_tags["own"].tolist() == [3, 1, 4, 1]
    assert tagged.cell_tags["yes"].tolist() == [1, 0, 0, 1]


def test_what_was_there_stays_and_equal_names_are_replaced() -> None:
    mesh = replace(
        samples.squares(2),
        cell_tags={"a": [1, 2, 3, 4], "b": [5, 6, 7, 8]},
        face_tags={"wall": np.arange(12)},
        repairs={"something": 1},
        name="mine",
    )
    tagged = mesh.with_tags(b=[0, 0, 0, 0], self=[1, 1, 1, 1], **{"rock type": [9, 9, 9, 9]})
    assert list(tagged.cell_tags) == ["a", "b", "self", "rock type"]
    assert tagged.cell_tags["a"].tolist() == [1, 2, 3, 4]
    assert tagged.cell_tags["b"].tolist() == [0, 0, 0, 0]
    assert tagged.face_tags["wall"].tolist() == list(range(12))
    assert (tagged.name, tagged.repairs, tagged.fingerprint) == ("mine", {"something": 1}, mesh.fingerprint)
    again = tagged.with_face_tags(wall=np.zeros(12, bool))
    assert not again.face_tags["wall"].any()
    assert list(again.cell_tags) == ["a", "b", "self", "rock type"]


@pytest.mark.parametrize("shift", [0.0, 1e6])
def test_faces_are_tagged_by_their_midpoints(shift: float) -> None:
    points = samples.voronoi(60, seed=7).points + shift
    mesh = replace(samples.voronoi(60, seed=7), points=points)
    ends = points[mesh.face_vertices.reshape(-1, 2)]
    assert np.array_equal(mesh.face_centroids, 0.5 * (ends[:, 0] + ends[:, 1]))
    tagged = mesh.with_face_tags(wall=lambda x: np.isclose(x[:, 0], shift, rtol=0, atol=1e-9))
    outer = (mesh.face_cells[:, 1] < 0) & (np.abs(ends[:, :, 0] - shift).max(axis=1) < 1e-9)
    assert 0 < outer.sum() < (mesh.face_cells[:, 1] < 0).sum()
    assert np.array_equal(tagged.face_tags["wall"], outer)


def test_faces_of_solids_are_tagged_by_their_centroids() -> None:
    mesh = samples.boxes(3)
    corners = mesh.points[mesh.face_vertices.reshape(-1, 4)]
    np.testing.assert_allclose(mesh.face_centroids, corners.mean(axis=1), atol=1e-14)
    tagged = mesh.with_face_tags(floor=lambda x: np.isclose(x[:, 2], 0))
    assert tagged.face_tags["floor"].sum() == 9
    normals = mesh.face_normals[tagged.face_tags["floor"] == 1]
    assert normals.tolist() == [[0, 0, -1]] * 9


def test_centroids_of_slanted_faces_of_solids() -> None:
    mesh = samples.tetrahedra(2)
    corners = mesh.points[mesh.face_vertices.reshape(-1, 3)]
    np.testing.assert_allclose(mesh.face_centroids, corners.mean(axis=1), atol=1e-14)


@pytest.mark.parametrize(
    ("values", "says"),
    [
        (lambda x: x[0] < 0.5, r"cell tag 'it': for x of shape \(16, 2\) the function returned shape \(2,\)"),
        (lambda x: 3, r"returned shape \(\), expected \(16,\), a value for each row of x"),
        (lambda x: x[:, 0], "cell tag 'it' must hold integers, not float64"),
        (lambda x: None, r"returned shape \(\)"),
        (np.zeros(16), "cell tag 'it' must hold integers, not float64"),
        (np.zeros(15, int), r"cell tag 'it' has shape \(15,\), expected \(16,\)"),
        (np.zeros((16, 1), int), r"cell tag 'it' has shape \(16, 1\), expected \(16,\)"),
        (5, r"cell tag 'it' has shape \(\), expected \(16,\)"),
        (["a"] * 16, "cell tag 'it' must hold integers, not <U1"),
        ([2**70] * 16, "cell tag 'it' must hold integers, not object"),
        ([[1], [1, 2]], "cell tag 'it' must be an array of numbers"),
    ],
)
def test_values_that_do_not_fit_are_refused_by_name(values, says: str) -> None:
    with pytest.raises(MeshError, match=says):
        samples.squares(4).with_tags(fits=np.zeros(16, int), it=values)


def test_values_that_do_not_fit_the_faces_are_refused_by_name() -> None:
    mesh = samples.squares(4)
    with pytest.raises(MeshError, match=r"face tag 'wall' has shape \(16,\), expected \(40,\)"):
        mesh.with_face_tags(wall=np.zeros(16, int))
    with pytest.raises(MeshError, match=r"face tag 'wall': for x of shape \(40, 2\) the function returned"):
        mesh.with_face_tags(wall=lambda x: x[0] < 1)


def test_what_the_function_raises_passes_and_it_cannot_change_the_mesh() -> None:
    mesh = samples.squares(2)
    with pytest.raises(ZeroDivisionError):
        mesh.with_tags(bad=lambda x: 1 / 0)
    with pytest.raises(ValueError, match="read-only"):
        mesh.with_tags(bad=lambda x: x.sort())


def test_tags_go_on_to_rules_and_files(tmp_path) -> None:
    mesh = samples.voronoi(80, seed=2).with_tags(left=lambda x: x[:, 0] < 0.5)
    labels = agglomerate(mesh, bisector="coordinate", n_parts=6, regions="left").levels[0]
    sides = [set(mesh.cell_tags["left"][labels == part].tolist()) for part in range(labels.max() + 1)]
    assert all(len(side) == 1 for side in sides)
    write(tmp_path / "it.vtu", mesh)
    back: Mesh = read(tmp_path / "it.vtu")
    assert np.array_equal(back.cell_tags["left"], mesh.cell_tags["left"])
