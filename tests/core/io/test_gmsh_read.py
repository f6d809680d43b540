"""Reading Gmsh files: groups by name, partitions, elements in several groups, element data."""

from __future__ import annotations

import logging
import struct
from collections.abc import Sequence
from pathlib import Path

import numpy as np
import pytest

from agglo_core import FileError, Mesh, MeshError, read, read_hierarchy, write

Numbers = Sequence[tuple[str, Sequence[float]]]

NAMES = '$PhysicalNames\n5\n0 1 "corner"\n1 3 "inlet"\n1 4 "wall"\n2 7 "all"\n2 8 "left"\n$EndPhysicalNames\n'
POINTS = [(0, 0, 0), (1, 0, 0), (2, 0, 0), (0, 1, 0), (1, 1, 0), (2, 1, 0)]
NODES = [10, 20, 30, 40, 50, 60]  # with gaps


def packed(numbers: Numbers, order: str) -> bytes:
    """Numbers as text, a line for each run, or binary: ``i`` of 4 bytes, ``z`` of 8, ``d`` doubles."""
    if not order:
        return "".join(" ".join(f"{x:.17g}" for x in values) + "\n" for _, values in numbers).encode()
    kinds = {"i": "i", "z": "Q", "d": "d"}
    values = b"".join(struct.pack(f"{order}{len(v)}{kinds[kind]}", *v) for kind, v in numbers)
    return values + b"\n"


def partitioned(version: str, order: str, *, names: str = NAMES) -> bytes:
    """Two unit squares, each a partition of one surface, and three edges of their boundary.

    The left square is in two groups, the other in one; the edge on the left is in two, the others in none.
    """
    newer = version == "4.1"
    box: Numbers = [("d", [0.0, 0, 0, 1, 1, 0])]
    surfaces: list[tuple[str, Sequence[float]]] = []
    for tag, groups in ((11, [7, 8]), (12, [-7])):
        parent: Numbers = [("i", [tag, 2, 1]), ("z", [1]), ("i", [tag - 10])]
        surfaces += [*parent, *box, ("z", [len(groups)]), ("i", groups), ("z", [1]), ("i", [21])]
    curves: list[tuple[str, Sequence[float]]] = []
    for tag, groups in ((21, [3, 4]), (22, [])):
        parent = [("i", [tag, 1, 1]), ("z", [1]), ("i", [1])]
        curves += [*parent, *box, ("z", [len(groups)]), ("i", groups), ("z", [0])]
    point: Numbers = [
        ("i", [31, 0, 1]),
        ("z", [0]),
        ("d", [0.0] * (3 if newer else 6)),
        ("z", [1]),
        ("i", [1]),
    ]
    entities: Numbers = [("z", [2, 1]), ("i", [99, 1]), ("z", [1, 2, 2, 0]), *point, *curves, *surfaces]
    if newer:
        table: Numbers = [("z", NODES), *(("d", each) for each in POINTS)]
        nodes: Numbers = [("z", [1, 6, 10, 60]), ("i", [2, 11, 0]), ("z", [6]), *table]
    else:
        rows = [(n, p) for n, p in zip(NODES, POINTS, strict=True)]
        table = [part for n, p in rows for part in (("i", [n]), ("d", p))]
        nodes = [("z", [1, 6]), ("i", [11, 2, 0]), ("z", [6]), *table]
    number = "z" if newer else "i"
    elements: list[tuple[str, Sequence[float]]] = [("z", [4, 5, 1, 9] if newer else [4, 5])]
    for dim, tag, kind, rows_ in (
        (2, 11, 3, [[5, 10, 20, 50, 40]]),
        (2, 12, 3, [[7, 20, 30, 60, 50]]),
        (1, 21, 1, [[1, 10, 40]]),
        (1, 22, 1, [[2, 10, 20], [3, 20, 30]]),
    ):
        place = [dim, tag] if newer else [tag, dim]
        elements += [("i", [*place, kind]), ("z", [len(rows_)]), *((number, row) for row in rows_)]
    one = struct.pack(f"{order}i", 1) + b"\n" if order else b""
    head = f"$MeshFormat\n{version} {int(bool(order))} 8\n".encode() + one + b"$EndMeshFormat\n"
    content = head + names.encode()
    for title, numbers in (
        ("Entities", [("z", [0, 0, 0, 0])]),
        ("PartitionedEntities", entities),
        ("Nodes", nodes),
        ("Elements", elements),
    ):
        content += f"${title}\n".encode() + packed(numbers, order) + f"$End{title}\n".encode()
    return content


@pytest.mark.parametrize("order", ["", "<", ">"])
@pytest.mark.parametrize("version", ["4.0", "4.1", "4"])
def test_groups_of_partitioned_files(
    version: str, order: str, tmp_path: Path, caplog: pytest.LogCaptureFixture
) -> None:
    content = partitioned("4.1" if version == "4" and order else version, order)
    (tmp_path / "m.msh").write_bytes(content)
    mesh = read(tmp_path / "m.msh")
    assert mesh.cell_measures.tolist() == [1, 1]
    assert {name: tag.tolist() for name, tag in mesh.cell_tags.items()} == {
        "gmsh:physical": [7, 7],
        "gmsh:geometrical": [1, 1],
        "gmsh:partition": [1, 2],
        "all": [1, 1],
        "left": [1, 0],
    }
    for name in ("inlet", "wall"):
        inside = np.flatnonzero(mesh.face_tags[name] == 1)
        assert mesh.face_centroids[inside].tolist() == [[0, 0.5]]
        assert np.bincount(mesh.face_tags[name] + 1).tolist() == [4, 2, 1]  # not listed, listed, in the group
    assert "groups left out because they have no cell or face of the mesh: corner" in caplog.text


def test_what_was_a_tag_of_a_file_is_written_to_the_next(tmp_path: Path) -> None:
    (tmp_path / "m.msh").write_bytes(partitioned("4.1", ""))
    write(tmp_path / "n.msh", read(tmp_path / "m.msh"))
    tags = read(tmp_path / "n.msh").cell_tags
    assert {name: tags[name].tolist() for name in ("gmsh:partition", "all", "left")} == {
        "gmsh:partition": [1, 2],
        "all": [1, 1],
        "left": [1, 0],
    }


def test_groups_without_a_name(tmp_path: Path) -> None:
    """The first group of each element is its number; others are tags of their own."""
    (tmp_path / "m.msh").write_bytes(partitioned("4.1", "", names=""))
    mesh = read(tmp_path / "m.msh")
    assert mesh.cell_tags["gmsh:physical"].tolist() == [7, 7]
    assert mesh.cell_tags["gmsh:physical_8"].tolist() == [1, 0]
    assert mesh.face_tags["gmsh:physical_4"].tolist().count(1) == 1
    assert mesh.face_tags["gmsh:physical"].tolist().count(3) == 1


def test_a_physical_name_may_occur_in_two_dimensions(tmp_path: Path) -> None:
    names = '$PhysicalNames\n2\n1 3 "rock"\n2 8 "rock"\n$EndPhysicalNames\n'
    (tmp_path / "m.msh").write_bytes(partitioned("4.1", "", names=names))
    mesh = read(tmp_path / "m.msh")
    assert mesh.cell_tags["rock"].tolist() == [1, 0]
    assert np.flatnonzero(mesh.face_tags["rock"] == 1).size == 1


# Version 2: number, type, number of tags, group, entity, partitions, nodes
SEVERAL = [
    (1, 1, [3, 1], [10, 40]),
    (2, 1, [4, 1], [10, 40]),
    (3, 1, [4, 1], [10, 20]),
    (4, 3, [7, 1, 1, 1], [10, 20, 50, 40]),
    (5, 3, [8, 1, 1, 1], [10, 20, 50, 40]),
    (6, 3, [7, 2, 2, 2, -1], [20, 30, 60, 50]),
]


def version_2(order: str, elements: Sequence[tuple[int, int, list[int], list[int]]] = SEVERAL) -> bytes:
    one = struct.pack(f"{order}i", 1) + b"\n" if order else b""
    nodes = [part for n, p in zip(NODES, POINTS, strict=True) for part in (("i", [n]), ("d", p))]
    rows: list[tuple[str, Sequence[float]]] = []
    for number, kind, tags, own in elements:
        head = [kind, 1, len(tags), number] if order else [number, kind, len(tags)]
        rows.append(("i", [*head, *tags, *own]))
    return b"".join(
        (
            f"$MeshFormat\n2.2 {int(bool(order))} 8\n".encode() + one + b"$EndMeshFormat\n" + NAMES.encode(),
            b"$Nodes\n6\n" + packed(nodes, order) + b"$EndNodes\n",
            f"$Elements\n{len(elements)}\n".encode() + packed(rows, order) + b"$EndElements\n",
        )
    )


@pytest.mark.parametrize("order", ["", "<", ">"])
def test_an_element_in_two_groups_is_one_cell(order: str, tmp_path: Path) -> None:
    (tmp_path / "m.msh").write_bytes(version_2(order))
    mesh = read(tmp_path / "m.msh")
    assert mesh.cell_measures.tolist() == [1, 1]
    tags = {name: mesh.cell_tags[name].tolist() for name in ("all", "left", "gmsh:partition")}
    assert tags == {"all": [1, 1], "left": [1, 0], "gmsh:partition": [1, 2]}
    ends = {
        name: sorted(mesh.face_centroids[mesh.face_tags[name] == 1].tolist()) for name in ("inlet", "wall")
    }
    assert ends == {"inlet": [[0, 0.5]], "wall": [[0, 0.5], [0.5, 0]]}
    assert mesh.repairs["lower-dimensional cells kept as face tags"] == 2


def test_an_element_twice_in_one_group_is_a_duplicate(tmp_path: Path) -> None:
    (tmp_path / "m.msh").write_bytes(version_2("", [*SEVERAL, (7, 3, [8, 1], [10, 20, 50, 40])]))
    with pytest.raises(MeshError, match="cells 0 and 2 are duplicates"):
        read(tmp_path / "m.msh")


def data(name: str, rows: Sequence[tuple[int, float]], step: int = 0) -> bytes:
    lines = "".join(f"{number} {value}\n" for number, value in rows)
    return f'$ElementData\n1\n"{name}"\n1\n0.0\n3\n{step}\n1\n{len(rows)}\n{lines}$EndElementData\n'.encode()


def test_element_data_of_some_elements(tmp_path: Path, caplog: pytest.LogCaptureFixture) -> None:
    """Data go by the numbers of elements, whichever listing of an element in two groups has them."""
    content = version_2("") + data("whole", [(6, 5), (5, 4)]) + data("part", [(6, 3), (3, 9)])
    content += data("real", [(6, 0.5)]) + data("in_parts", [(4, 1)]) + data("in_parts", [(6, 2)])
    (tmp_path / "m.msh").write_bytes(
        content + data("late", [(4, 1), (6, 1)]) + data("late", [(4, 2), (6, 3)], 1)
    )
    mesh = read(tmp_path / "m.msh")
    tags = {name: mesh.cell_tags[name].tolist() for name in ("whole", "part", "in_parts", "late")}
    assert tags == {"whole": [4, 5], "part": [-1, 3], "in_parts": [1, 2], "late": [2, 3]}
    (bottom,) = np.flatnonzero(mesh.face_tags["part"] == 9)
    assert mesh.face_centroids[bottom].tolist() == [0.5, 0]
    assert mesh.repairs["cell data that are not integers left out"] == 1
    said = [record.getMessage() for record in caplog.records if record.levelno == logging.WARNING]
    assert "element data 'part': 1 of 2 cells have no value and get −1" in said
    assert "element data 'late': only the last time step, 1, is read" in said
    assert not any("whole" in each or "in_parts" in each for each in said)


def test_levels_in_element_data(tmp_path: Path) -> None:
    (tmp_path / "m.msh").write_bytes(version_2("") + data("level_0", [(4, 0), (6, 1)]))
    _, hierarchy = read_hierarchy(tmp_path / "m.msh")
    assert hierarchy is not None
    assert hierarchy.levels[0].tolist() == [0, 1]


def test_two_cells_of_other_numbers_on_a_face(tmp_path: Path, caplog: pytest.LogCaptureFixture) -> None:
    """Two lines on one face, of different entities and groups: both names stay, one of the numbers."""
    content = partitioned("4.1", "")
    for old, new in ((b"4 5 1 9", b"5 6 1 9"), (b"1 21 1\n1\n", b"1 22 1\n1\n8 40 10\n1 21 1\n1\n")):
        assert content.count(old) == 1
        content = content.replace(old, new)
    (tmp_path / "m.msh").write_bytes(content)
    mesh = read(tmp_path / "m.msh")
    assert np.count_nonzero(mesh.face_tags["inlet"] == 1) == 1
    assert np.count_nonzero(mesh.face_tags["gmsh:physical"] == 3) == 1
    assert "tag 'gmsh:physical': 1 cells on faces differ from the value kept, the largest" in caplog.text


@pytest.mark.parametrize(
    ("old", "new", "says"),
    [
        (b"4.1 0 8", b"3.0 0 8", r"Gmsh format version 3\.0 is not supported"),
        (b"4.1 0 8", b"4.1 2 8", r"\$MeshFormat is '4\.1 2 8'"),
        (b"$EndNodes", b"", r"truncated: \$Nodes has no \$EndNodes"),
        (b"$Nodes", b"$Knots", r"truncated: \$Knots"),
        (b"5 10 20 50 40", b"5 10 20 50 41", "an element uses node 41, which the file does not list"),
        (b"5 10 20 50 40", b"5 10 20 50 4.5", r"\$Elements: expected a whole number, found 4\.5"),
        (b"5 10 20 50 40", b"5 10 20 50", r"\$Elements ends before|\$Elements: "),
        (b"2 11 3\n", b"2 11 140\n", "Gmsh element type 140 is not supported"),
        (b"2 11 3\n1\n", b"2 11 3\n900000000000\n", r"truncated: \$Elements ends before its last number"),
        (b"2 11 0\n6\n", b"2 11 -1\n6\n", r"\$Nodes: the parametric flag of a block is -1"),
        (b"$Nodes\n", b"nodes\n", r"line \d+: expected a section such as \$Nodes"),
    ],
)
def test_faults_are_named(old: bytes, new: bytes, says: str, tmp_path: Path) -> None:
    content = partitioned("4.1", "")
    assert old in content
    (tmp_path / "m.msh").write_bytes(content.replace(old, new, 1))
    with pytest.raises(FileError, match=says):
        read(tmp_path / "m.msh")


@pytest.mark.parametrize("order", ["", "<"])
def test_orders_of_elements(order: str, tmp_path: Path) -> None:
    """A triangle of 10 nodes and a quadrilateral of 8, by their corners."""
    curved = [(1, 21, [7, 1], [10, 20, 50, *[60] * 7]), (2, 16, [8, 1], [20, 30, 60, 50, *[10] * 4])]
    (tmp_path / "m.msh").write_bytes(version_2(order, curved))
    mesh = read(tmp_path / "m.msh")
    assert mesh.cell_measures.tolist() == [0.5, 1]
    assert mesh.repairs["higher-order cells reduced to their corners"] == 2


def test_parametric_nodes(tmp_path: Path) -> None:
    """Version 4 gives parameters after the coordinates; files of version 2 have another section."""
    content = partitioned("4.1", "")
    rows = content.index(b"0 0 0\n1 0 0\n2 0 0\n")
    given = b"".join(b"%d %d 0 .25 .5\n" % (x, y) for x, y, _ in POINTS)
    stop = content.index(b"$EndNodes")
    content = (content[:rows] + given + content[stop:]).replace(b"2 11 0\n", b"2 11 1\n")
    (tmp_path / "m.msh").write_bytes(content)
    assert read(tmp_path / "m.msh").cell_measures.tolist() == [1, 1]
    (tmp_path / "m.msh").write_bytes(version_2("").replace(b"Nodes", b"ParametricNodes"))
    with pytest.raises(FileError, match=r"nodes are parametric: save it with Mesh\.SaveParametric = 0"):
        read(tmp_path / "m.msh")


def test_names_in_latin_1(tmp_path: Path) -> None:
    content = partitioned("4.1", "").replace(b'"left"', '"gauche é"'.encode("latin-1"))
    (tmp_path / "m.msh").write_bytes(content)
    mesh: Mesh = read(tmp_path / "m.msh")
    assert mesh.cell_tags["gauche é"].tolist() == [1, 0]
