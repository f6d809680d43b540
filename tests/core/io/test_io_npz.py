"""npz: lossless both ways, the plain layout, and files that are wrong."""

from __future__ import annotations

import io
import json
import zipfile
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from hypothesis import given, settings, strategies as st

from agglo_core.arrays import trusted
from agglo_core.errors import AggloError, PluginError
from agglo_core.hierarchy import Hierarchy
from agglo_core.io import read, read_hierarchy, write
from agglo_core.mesh import Mesh

POINTS = np.array([[0, 0], [1, 0], [1, 1], [0, 1], [2, 0], [2, 1 / 3]])
LOOPS = [[0, 1, 2, 3], [2, 5, 4, 1]]  # the second clockwise... reversed on building


def tagged() -> Mesh:
    mesh = Mesh.from_polygons(POINTS, LOOPS, cell_tags={"mat": [3, -4], "ä/ö": [0, 1]}, name="two")
    return Mesh(
        mesh.points,
        mesh.face_offsets,
        mesh.face_vertices,
        mesh.face_cells,
        mesh.cell_tags,
        {"wall": np.arange(mesh.n_faces)},
        {"clockwise cells reversed": 1},
        "two",
    )


def test_lossless(tmp_path: Path) -> None:
    mesh = tagged()
    targets: list[dict[str, Any]] = [{"h_star": 1 / 3}, {"parts": 1}]
    statistics = {
        "seconds": np.float64(0.25),
        "counts": np.arange(3),
        "levels": [{"parts": 2}],
        "n": np.int64(7),
    }
    levels = [np.array([0, 1]), np.array([0, 0])]
    write(tmp_path / "m.npz", mesh, Hierarchy(mesh, mesh.graph, levels, targets, True, statistics))
    back, hierarchy = read_hierarchy(tmp_path / "m.npz")
    assert back.fingerprint == mesh.fingerprint
    assert back.name == "two"
    assert back.repairs == mesh.repairs
    for found, given_tags in ((back.cell_tags, mesh.cell_tags), (back.face_tags, mesh.face_tags)):
        assert {k: v.tolist() for k, v in found.items()} == {k: v.tolist() for k, v in given_tags.items()}
    assert hierarchy is not None
    assert hierarchy.nested
    assert hierarchy.targets == targets
    assert [labels.tolist() for labels in hierarchy.levels] == [[0, 1], [0, 0]]
    assert hierarchy.statistics == {"seconds": 0.25, "counts": [0, 1, 2], "levels": [{"parts": 2}], "n": 7}
    assert read(tmp_path / "m.npz").fingerprint == mesh.fingerprint


def test_equal_points_stay(tmp_path: Path) -> None:
    points = [[0, 0], [1, 0], [0, 1], [1, 0], [1, 1], [0, 1]]
    mesh = Mesh.from_polygons(points, [[0, 1, 2], [3, 4, 5]], allow_gaps=True)
    write(tmp_path / "slit.npz", mesh)
    assert read(tmp_path / "slit.npz").n_points == 6


def test_plain_layout(tmp_path: Path) -> None:
    np.savez(
        tmp_path / "plain.npz", points=POINTS, cell_offsets=[0, 4, 8], cell_vertices=np.concatenate(LOOPS)
    )
    mesh, hierarchy = read_hierarchy(tmp_path / "plain.npz")
    assert hierarchy is None
    assert mesh.name == "plain"
    np.testing.assert_allclose(mesh.cell_measures, [1, 2 / 3])
    assert mesh.repairs["clockwise cells reversed"] == 1


def refused(file: Path, match: str) -> None:
    with pytest.raises(AggloError, match=match) as caught:
        read(file)
    assert str(file) in str(caught.value)
    assert not isinstance(caught.value, PluginError)


@pytest.mark.parametrize(
    ("change", "match"),
    [
        ({"points": None}, "neither an agglo mesh .* nor the arrays"),
        ({"points": np.array(["a"])}, "'points' has dtype"),
        ({"points": POINTS[0]}, "'points' has dtype"),
        ({"points": np.full((6, 2), np.nan)}, "not finite"),
        ({"cell_offsets": np.array([0.0, 4.0, 8.0])}, "'cell_offsets' has dtype float64"),
        ({"cell_offsets": np.array([0, 4, 9])}, r"'cell_vertices' has shape \(8,\).*\(9\)"),
        ({"cell_vertices": np.array([0, 1, 2, 3, 1, 4, 5, 600])}, "600"),
        ({"points": np.array([{}], dtype=object)}, "'points' is corrupt.*objects"),
    ],
)
def test_plain_layout_wrong(tmp_path: Path, change: dict[str, Any], match: str) -> None:
    arrays = {"points": POINTS, "cell_offsets": np.array([0, 4, 8]), "cell_vertices": np.concatenate(LOOPS)}
    merged = {name: values for name, values in (arrays | change).items() if values is not None}
    np.savez(tmp_path / "p.npz", **merged)  # type: ignore[arg-type]
    refused(tmp_path / "p.npz", match)


def altered(tmp_path: Path, name: str, content: bytes | None) -> Path:
    """A native file with one member replaced or left out."""
    write(tmp_path / "good.npz", tagged())
    with zipfile.ZipFile(tmp_path / "good.npz") as good, zipfile.ZipFile(tmp_path / "bad.npz", "w") as bad:
        for member in good.namelist():
            if member != f"{name}.npy":
                bad.writestr(member, good.read(member))
            elif content is not None:
                bad.writestr(member, content)
    return tmp_path / "bad.npz"


def npy(values: Any) -> bytes:
    stream = io.BytesIO()
    np.save(stream, values)
    return stream.getvalue()


def meta(**changes: Any) -> bytes:
    base = {"format": "agglo", "version": 2, "name": "", "repairs": {}, "cell_tags": [], "face_tags": []}
    return npy(np.frombuffer(json.dumps(base | changes).encode(), np.uint8))


@pytest.mark.parametrize(
    ("name", "content", "match"),
    [
        ("points", None, "'points' is missing"),
        ("cell_tag_1", None, "'cell_tag_1' is missing"),
        ("cell_tag_1", npy(np.arange(3)), "shape"),
        ("points", npy(POINTS + 1), "fingerprint"),
        ("face_cells", npy(np.zeros((7, 2))), "'face_cells' has dtype float64"),
        ("face_offsets", npy(np.zeros(0, int)), "corrupt"),
        ("points", npy(POINTS)[:-8], "'points' is corrupt.*bytes follow"),
        ("points", npy(POINTS).replace(b"(6, 2)", b"(9**9,"), "'points' is corrupt"),
        (
            "points",
            npy(np.zeros((10, 10))).replace(b"(10, 10)", b"(9999999999999999, 99)"),
            "'points' is corrupt",
        ),
        ("points", b"nonsense", "'points' is corrupt"),
        ("meta", npy(np.frombuffer(b"{", np.uint8)), "'meta' is corrupt"),
        ("meta", npy(np.frombuffer(b"[1]", np.uint8)), "does not describe"),
        ("meta", meta(format="other"), "does not describe"),
        ("meta", meta(version=99), "version 99 is unknown"),
        ("meta", meta(), "corrupt"),
        ("meta", meta(fingerprint="0"), "fingerprint"),
        ("meta", meta(repairs=3), "corrupt"),
        ("meta", meta(repairs={"merged": float("inf")}), "corrupt"),
        ("face_cells", npy(np.full((7, 2), 255, np.uint8)), "fingerprint|corrupt|shape"),
        (
            "face_cells",
            npy(np.full((7, 2), 2**64 - 1, np.uint64)),
            "18446744073709551615, more than an int64",
        ),
        ("face_offsets", npy(np.full(8, 2**63, np.uint64)), "holds 9223372036854775808, more than an int64"),
    ],
)
def test_native_wrong(tmp_path: Path, name: str, content: bytes | None, match: str) -> None:
    refused(altered(tmp_path, name, content), match)


@pytest.mark.parametrize("dtype", ["u1", ">u2", "u4", "<u8", "i1", ">i8"])
def test_integers_of_every_width_are_read(tmp_path: Path, dtype: str) -> None:
    mesh = tagged()
    write(tmp_path / "m.npz", mesh)
    stored = dict(np.load(tmp_path / "m.npz"))
    for name in ("face_offsets", "face_vertices", "cell_tag_0", *(["face_cells"] if "i" in dtype else [])):
        assert stored[name].max() < 127
        if stored[name].min() >= 0 or "i" in dtype:
            stored[name] = stored[name].astype(dtype)
    np.savez(tmp_path / "m.npz", **stored)
    found = read(tmp_path / "m.npz")
    assert found.fingerprint == mesh.fingerprint
    assert np.array_equal(found.face_cells, mesh.face_cells)
    for name, values in mesh.cell_tags.items():
        assert np.array_equal(found.cell_tags[name], values)


@pytest.mark.parametrize("name", ["face_cells", "face_offsets", "face_vertices"])
def test_wrapped_negatives_are_refused(tmp_path: Path, name: str) -> None:
    """−1 stored as 255 or more is another number; arrays without −1 stay what they are."""
    mesh = tagged()
    write(tmp_path / "m.npz", mesh)
    stored = dict(np.load(tmp_path / "m.npz"))
    for dtype in ("u1", "u4", "u8"):
        np.savez(tmp_path / "u.npz", **{**stored, name: stored[name].astype(dtype)})
        if name == "face_cells":
            refused(tmp_path / "u.npz", "fingerprint|shape|int64")
        else:
            assert read(tmp_path / "u.npz").fingerprint == mesh.fingerprint


def test_indices_are_checked_behind_a_true_fingerprint(tmp_path: Path) -> None:
    mesh = tagged()
    for key, wrong in (
        ("face_cells", np.where(mesh.face_cells == 0, 5, mesh.face_cells)),
        ("points", mesh.points * np.nan),
    ):
        arrays = {
            name: getattr(mesh, name) for name in ("points", "face_offsets", "face_vertices", "face_cells")
        }
        write(tmp_path / "bad.npz", trusted(Mesh, **(arrays | {key: wrong})))
        refused(tmp_path / "bad.npz", key)


def test_not_an_archive(tmp_path: Path) -> None:
    (tmp_path / "a.npz").write_bytes(b"PK\x03\x04 and then nothing")
    refused(tmp_path / "a.npz", "not an npz archive")
    write(tmp_path / "b.npz", tagged())
    whole = (tmp_path / "b.npz").read_bytes()
    (tmp_path / "b.npz").write_bytes(whole[: len(whole) // 2])
    refused(tmp_path / "b.npz", "not an npz archive")


@settings(max_examples=200, deadline=None)
@given(st.data())
def test_mutations_never_leak(data: st.DataObject) -> None:
    """A file with altered bytes gives the very mesh or our error."""
    import tempfile

    with tempfile.TemporaryDirectory() as folder:
        file = Path(folder) / "m.npz"
        write(file, tagged())
        content = bytearray(file.read_bytes())
        for _ in range(data.draw(st.integers(1, 4))):
            content[data.draw(st.integers(0, len(content) - 1))] = data.draw(st.integers(0, 255))
        file.write_bytes(bytes(content))
        try:
            right = read(file).fingerprint == tagged().fingerprint
        except AggloError as error:
            right = str(file) in str(error) and not isinstance(error, PluginError)
        assert right
