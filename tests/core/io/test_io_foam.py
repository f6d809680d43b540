"""OpenFOAM cases: text, binary, gzipped; labels and scalars of 32 and 64 bits; patches, zones, levels."""

from __future__ import annotations

import gzip
import shutil
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from command_line import Agglo

from agglo_core import FileError, MeshError, agglomerate, read, read_hierarchy, samples, write
from agglo_core.problems import read_problem

HEAD = "FoamFile\n{\n    version 2.0;\n    format ascii;\n    class list;\n}\n"
CUBES = {  # two unit cubes side by side
    "points": [f"({x} {y} {z})" for z in (0, 1) for y in (0, 1) for x in (0, 1, 2)],
    "faces": [
        "4(1 4 10 7)",
        *("4(0 6 9 3)", "4(0 1 7 6)", "4(3 9 10 4)", "4(0 3 4 1)", "4(6 7 10 9)"),
        *("4(2 5 11 8)", "4(1 2 8 7)", "4(4 10 11 5)", "4(1 4 5 2)", "4(7 8 11 10)"),
    ],
    "owner": ["0"] * 6 + ["1"] * 5,
    "neighbour": ["1"],
}


def foam(folder: Path) -> Path:
    poly = folder / "constant" / "polyMesh"
    poly.mkdir(parents=True)
    for name, rows in CUBES.items():
        (poly / name).write_text(f"{HEAD}{len(rows)}\n(\n" + "\n".join(rows) + "\n)\n")
    patches = [
        f"{name}\n{{\n type patch;\n nFaces {count};\n startFace {start};\n}}"
        for name, (count, start) in {"inlet": (1, 1), "walls": (9, 2)}.items()
    ]
    (poly / "boundary").write_text(f"{HEAD}{len(patches)}\n(\n" + "\n".join(patches) + "\n)\n")
    (folder / "case.foam").touch()
    return folder / "case.foam"


def test_patches_of_openfoam_keep_their_names(tmp_path: Path, caplog: pytest.LogCaptureFixture) -> None:
    with caplog.at_level("INFO", "agglo"):
        mesh = read(foam(tmp_path))
    np.testing.assert_allclose(mesh.cell_measures, [1, 1])
    assert "faces by name: inlet (1), walls (9)" in caplog.text
    (inlet,) = np.flatnonzero(mesh.face_tags["inlet"] == 1)
    vertices = mesh.face_vertices[mesh.face_offsets[inlet] : mesh.face_offsets[inlet + 1]]
    assert mesh.points[vertices].mean(axis=0).tolist() == [0, 0.5, 0.5]
    assert (mesh.face_tags["walls"] == 1).sum() == 9
    assert mesh.face_tags["walls"][mesh.face_cells[:, 1] >= 0].tolist() == [-1]
    write(tmp_path / "m.npz", mesh)
    back = read(tmp_path / "m.npz")
    assert {"inlet", "walls"} <= back.face_tags.keys()
    coarse = back.coarsen([0, 0])
    assert (coarse.face_tags["inlet"] == 1).sum() == 1


def test_patches_are_chosen_by_name(tmp_path: Path) -> None:
    mesh = read(foam(tmp_path))
    file = tmp_path / "p.toml"
    file.write_text('boundary = "patch"\n[dirichlet]\ninlet = 2.0\n[neumann]\nwalls = 0.5\n')
    problem = read_problem(file, mesh)
    assert problem.dirichlet == {0: 2.0}
    assert problem.neumann == {1: 0.5}
    file.write_text('boundary = "patch"\n[dirichlet]\noutlet = 2.0\n')
    with pytest.raises(FileError, match=r"'outlet' must be a tag value .*names: inlet, walls"):
        read_problem(file, mesh)


def poly(case: Path) -> Path:
    return case.parent / "constant" / "polyMesh"


def binary(case: Path, label: int, scalar: int, order: str = "<") -> None:
    """The case as OpenFOAM writes it with the format binary."""
    arch = f'"{"LSB" if order == "<" else "MSB"};label={label};scalar={scalar}"'

    def put(name: str, kind: str, *arrays: tuple[Any, int, str]) -> None:
        head = (
            f"FoamFile\n{{\n version 2.0;\n format binary;\n arch {arch};\n class {kind};\n}}\n// * * //\n\n"
        )
        rows = b"".join(
            b"%d\n(%b)\n" % (n, np.asarray(each).astype(order + form).tobytes()) for each, n, form in arrays
        )
        (poly(case) / name).write_bytes(head.encode() + rows + b"\n// *** //\n")

    whole, real = f"i{label // 8}", f"f{scalar // 8}"
    points = np.array([row.strip("()").split() for row in CUBES["points"]], float)
    faces = [[int(v) for v in row[2:-1].split()] for row in CUBES["faces"]]
    starts = np.cumsum([0, *map(len, faces)])
    put("points", "vectorField", (points, len(points), real))
    put("faces", "faceCompactList", (starts, len(starts), whole), (np.concatenate(faces), starts[-1], whole))
    for name in ("owner", "neighbour"):
        values = [int(v) for v in CUBES[name]]
        put(name, "labelList", (values, len(values), whole))


@pytest.mark.parametrize("order", ["<", ">"])
@pytest.mark.parametrize("label", [32, 64])
@pytest.mark.parametrize("scalar", [32, 64])
def test_binary_cases(tmp_path: Path, label: int, scalar: int, order: str) -> None:
    case = foam(tmp_path)
    text = read(case)
    binary(case, label, scalar, order)
    assert read(case).fingerprint == text.fingerprint
    cut = poly(case) / "points"
    cut.write_bytes(cut.read_bytes()[:-60])
    with pytest.raises(FileError, match=rf"points: the list of 36 {scalar}-bit values is not closed"):
        read(case)


def test_headers_that_do_not_say_how_wide(tmp_path: Path) -> None:
    case = foam(tmp_path)
    binary(case, 32, 64)
    for file in poly(case).iterdir():
        file.write_bytes(file.read_bytes().replace(b'arch "LSB;label=32;scalar=64";', b""))
    assert read(case).n_cells == 2


def test_gzipped_cases(tmp_path: Path) -> None:
    case = foam(tmp_path)
    text = read(case)
    for file in list(poly(case).iterdir()):
        file.with_name(f"{file.name}.gz").write_bytes(gzip.compress(file.read_bytes()))
        file.unlink()
    assert read(case).fingerprint == text.fingerprint
    (poly(case) / "owner.gz").write_bytes(gzip.compress(b"FoamFile{}" + bytes(1 << 27)))
    with pytest.raises(FileError, match=r"owner\.gz: it inflates to more than 40 times its size"):
        read(case)
    (poly(case) / "owner.gz").write_bytes(gzip.compress(b"FoamFile{}")[:-9])
    with pytest.raises(FileError, match=r"owner\.gz: truncated"):
        read(case)


def test_any_file_of_the_mesh_is_recognised(tmp_path: Path) -> None:
    assert read(poly(foam(tmp_path)) / "owner").n_cells == 2


def test_comments_and_equal_labels(tmp_path: Path) -> None:
    case = foam(tmp_path)
    (poly(case) / "neighbour").write_text(HEAD + "// one inner face\n/* of all */ 1{1}\n")
    faces = (poly(case) / "faces").read_text()
    (poly(case) / "faces").write_text(
        faces.replace("4(1 4 10 7)", "4(1 4 10 7) // the inner one") + "// ** (end) **\n"
    )
    assert read(case).cell_measures == pytest.approx([1, 1])


def test_cell_zones_are_tags(tmp_path: Path) -> None:
    case = foam(tmp_path)
    zone = "{0}\n{{\n    type cellZone;\ncellLabels      List<label>\n{1}\n;\n}}\n"
    text = HEAD + "2\n(\n" + zone.format("rotor", "1\n(\n1\n)") + zone.format("all", "2{0}") + ")\n"
    (poly(case) / "cellZones").write_text(text)
    mesh = read(case)
    assert mesh.cell_tags["rotor"].tolist() == [0, 1]
    (poly(case) / "cellZones").write_text(text.replace("(\n1\n)", "(\n2\n)"))
    with pytest.raises(FileError, match=r"cellZones: 'rotor' lists cells outside 0\.\.1"):
        read(case)


@pytest.mark.parametrize(
    ("name", "old", "new", "says"),
    [
        ("points", "(0 0 0)", "(0 0)", "points: 12 points are declared, but 35 coordinates follow"),
        ("points", "(0 0 0)", "(0 0 x)", "line .*: expected a number, found 'x'"),
        ("points", "format ascii", "format asci", "points: unknown format 'asci'"),
        ("points", "FoamFile", "File", "points: the header FoamFile is missing"),
        ("faces", "4(1 4 10 7)", "4(1 4 10 70)", r"faces: face 0 uses points outside 0\.\.11"),
        ("faces", "4(1 4 10 7)", "4(1 4 10 1)", "faces: face 0 has a repeated point"),
        ("faces", "4(1 4 10 7)", "2(1 4)", "faces: face 0 has fewer than 3 points"),
        ("faces", "4(1 4 10 7)", "5(1 4 10 7)", "faces take|longer than the rest"),
        ("faces", "4(1 4 10 7)", "4(1 7 10 4)", "the faces do not close"),
        ("owner", "11\n", "10\n", "owner: 10 labels are declared, but 11 follow"),
        ("owner", "(\n0", "(\n90", "list cells 0 to 90, but there are 11 faces"),
        ("neighbour", "1\n(\n1\n)", "1{1", "must give one label"),
        ("neighbour", "1\n(\n1\n)", "99999999999{1}", "a list of 99999999999 equal values is too long"),
        (
            "boundary",
            "startFace 2",
            "startFace 20",
            "patch 'walls' must lie within 11 faces, given startFace 20, nFaces 9",
        ),
    ],
)
def test_faults_are_named(tmp_path: Path, name: str, old: str, new: str, says: str) -> None:
    case = foam(tmp_path)
    file = poly(case) / name
    assert old in file.read_text()
    file.write_text(file.read_text().replace(old, new, 1))
    with pytest.raises((FileError, MeshError), match=f"case.foam: .*({says})"):
        read(case)


def test_a_case_without_a_mesh(tmp_path: Path) -> None:
    (tmp_path / "m.foam").touch()
    with pytest.raises(FileError, match=r"OpenFOAM case without a mesh: .*blockMesh"):
        read(tmp_path / "m.foam")
    case = foam(tmp_path)
    (poly(case) / "owner").unlink()
    with pytest.raises(FileError, match=r"neither .*owner nor owner\.gz exists"):
        read(case)


@pytest.mark.parametrize("compress", [False, True])
def test_cases_are_written_and_read_back(tmp_path: Path, compress: bool) -> None:
    rng = np.random.default_rng(1)
    mesh = samples.boxes(4)
    mesh = mesh.coarsen(agglomerate(mesh, bisector="coordinate", n_parts=20).levels[0])
    outer = mesh.face_cells[:, 1] < 0
    low = outer & (mesh.points[mesh.face_vertices[mesh.face_offsets[:-1]]][:, 0] == 0)
    mesh = replace(
        mesh,
        cell_tags={"mat": rng.integers(-5, 5, 20), "a/b c": np.arange(20) + 2**40},
        face_tags={
            "inlet": np.where(outer, low, -1),
            "bc": np.where(outer, rng.integers(3, 5, len(outer)), -1),
        },
    )
    hierarchy = agglomerate(mesh, bisector="coordinate", n_parts=(8, 2))
    write(tmp_path / "m.foam", mesh, hierarchy, compress=compress)
    end = ".gz" if compress else ""
    found = sorted(str(each.relative_to(tmp_path)) for each in tmp_path.rglob("*") if each.is_file())
    names = [
        f"constant/polyMesh/{name}{end}" for name in ("boundary", "faces", "neighbour", "owner", "points")
    ]
    own = [f"constant/agglo/{name}{end}" for name in ("a%2Fb%20c", "level_0", "level_1", "mat")]
    assert found == sorted(
        [*names, *own, f"constant/cellDecomposition{end}", "0/level0", "0/level1", "m.foam"]
    )
    back, levels = read_hierarchy(tmp_path / "m.foam")
    assert {name: tag.tolist() for name, tag in back.cell_tags.items()} == {
        name: tag.tolist() for name, tag in mesh.cell_tags.items()
    }
    assert levels is not None
    assert [level.tolist() for level in levels.levels] == [level.tolist() for level in hierarchy.levels]
    assert abs(back.graph.to_scipy() - mesh.graph.to_scipy()).max() < 1e-15
    np.testing.assert_allclose(back.cell_measures, mesh.cell_measures, rtol=1e-15)
    assert set(back.face_tags) == {"inlet", "bc_3", "bc_4", "patch"}
    for name, count in (("inlet", low.sum()), ("bc_3", (mesh.face_tags["bc"][outer & ~low] == 3).sum())):
        assert (back.face_tags[name] == 1).sum() == count
    inner = back.face_cells[back.face_cells[:, 1] >= 0]
    assert (np.diff(inner[:, 0]) >= 0).all()  # in the order that OpenFOAM demands
    assert (inner[:, 0] < inner[:, 1]).all()


def test_tags_of_faces_that_are_in_no_patch_are_reported(
    tmp_path: Path, caplog: pytest.LogCaptureFixture
) -> None:
    """A face is in the patch of its first tag; negative values other than −1 are values as others."""
    mesh = samples.boxes(2)
    outer = mesh.face_cells[:, 1] < 0
    bc = np.where(outer, -5, -1)
    bc[np.flatnonzero(outer)[:3]] = 7
    bc[np.flatnonzero(outer)[3:5]] = -1
    wall = np.zeros(mesh.n_faces, int)
    wall[np.flatnonzero(outer)[:5]] = 1
    tags = {"bc": bc, "wall": wall, "crack": np.where(outer, 0, 1)}
    write(tmp_path / "m.foam", replace(mesh, face_tags=tags))
    assert "'wall': 2 of 5 faces written; OpenFOAM holds outer faces, each in one patch" in caplog.text
    assert "'crack': 0 of 12 faces written" in caplog.text
    assert "'bc'" not in caplog.text
    back = read(tmp_path / "m.foam")
    counts = {name: int((tag == 1).sum()) for name, tag in back.face_tags.items() if name != "patch"}
    assert counts == {"bc_-5": 19, "bc_7": 3, "wall": 2}
    caplog.clear()
    write(tmp_path / "n.foam", back)
    assert "faces written" not in caplog.text


def test_a_tag_of_inner_faces_takes_no_outer_face(tmp_path: Path) -> None:
    mesh = samples.layered(8)
    assert list(mesh.face_tags) == ["fault", "side"]
    write(tmp_path / "m.foam", mesh)
    back = read(tmp_path / "m.foam")
    sides = {name: int((tag == 1).sum()) for name, tag in back.face_tags.items() if name != "patch"}
    assert sides == {f"side_{i}": int((mesh.face_tags["side"] == i).sum()) for i in range(1, 7)}


def test_an_earlier_mesh_leaves_nothing(tmp_path: Path) -> None:
    mesh = replace(samples.boxes(2), cell_tags={"mat": np.arange(8)})
    write(tmp_path / "m.foam", mesh, compress=True)
    write(tmp_path / "m.foam", samples.boxes(3))
    assert not list((tmp_path / "constant").rglob("*.gz"))
    assert read(tmp_path / "m.foam").cell_tags == {}


def test_fields_for_other_programs(tmp_path: Path) -> None:
    mesh = samples.boxes(2)
    hierarchy = agglomerate(mesh, bisector="coordinate", n_parts=2)
    write(tmp_path / "m.foam", mesh, hierarchy)
    labels = [str(label) for label in hierarchy.levels[0]]
    split = (tmp_path / "constant" / "cellDecomposition").read_text()
    assert "class       labelList;" in split
    assert split.split("(\n")[1].split(")")[0].split() == labels
    field = (tmp_path / "0" / "level0").read_text()
    assert "class       volScalarField;" in field
    assert field.split("(\n")[1].split(")")[0].split() == labels
    assert "defaultFaces" in field.split("boundaryField")[1]
    with pytest.raises(FileError, match=r"OpenFOAM needs a 3-D mesh, given a 2-D one"):
        write(tmp_path / "p.foam", samples.squares(2))


def test_cell_tags_are_zones(tmp_path: Path) -> None:
    """Of those that overlap the first; zones that another mesh left go."""
    mesh = samples.boxes(2).with_tags(
        low=lambda x: x[:, 2] < 0.5, left=lambda x: x[:, 0] < 0.5, rock=np.arange(8)
    )
    (tmp_path / "constant/polyMesh").mkdir(parents=True)
    (tmp_path / "constant/polyMesh/faceZones").write_text("stale")
    write(tmp_path / "m.foam", mesh)
    zones = tmp_path / "constant/polyMesh/cellZones"
    said = " ".join(zones.read_text().split("}\n", 1)[1].split())
    assert said == "1 ( low { type cellZone; cellLabels List<label> 4 ( 0 1 2 3 ) ; } )"
    assert not (tmp_path / "constant/polyMesh/faceZones").exists()
    back = read(tmp_path / "m.foam")
    assert {name: tag.tolist() for name, tag in back.cell_tags.items()} == {
        name: tag.tolist() for name, tag in mesh.cell_tags.items()
    }
    write(tmp_path / "m.foam", samples.boxes(3))
    assert not zones.exists()


def change(case: Path, name: str, old: str, new: str) -> None:
    """Replace a text in a file of the mesh."""
    file = poly(case) / name
    assert old in file.read_text()
    file.write_text(file.read_text().replace(old, new, 1))


def faces_by_patch(case: Path) -> dict[str, list[int]]:
    """Numbers of the faces of each patch, as the file of the case orders them."""
    tags = read(case).face_tags
    return {name: np.flatnonzero(tag == 1).tolist() for name, tag in tags.items() if name != "patch"}


@pytest.mark.parametrize(
    ("old", "new"),
    [
        ("nFaces 1;", "// nFaces 3;\n nFaces 1;"),
        ("nFaces 1;", "/* nFaces 3;\n */ nFaces 1; // nFaces 4;"),
        ("inlet", "/* old { type wall; nFaces 2; startFace 0; } */ inlet"),
        ("inlet", "// startFace { of all } below\ninlet"),
        ("nFaces 1;", "nFaces 2; /**/ nFaces /* ; */ 1;"),
        ("nFaces 1;", 'note "nFaces 3; }"; nFaces 1;'),
        ("nFaces 1;", "AMI { surface { type triSurfaceMesh; nFaces 5; } } nFaces 1;"),
        ("nFaces 1;", "inGroups 2(wall slip(1)); weights (0.5 (1 2) { a b; }); nFaces 1;"),
        ("FoamFile", "// FoamFile {format binary;}\n/* FoamFile { format none; } */ FoamFile"),
        ("format ascii;", "// format binary; }\n format ascii; note { format binary; }"),
    ],
)
def test_dictionaries_of_patches(tmp_path: Path, old: str, new: str) -> None:
    case = foam(tmp_path)
    change(case, "boundary", old, new)
    assert faces_by_patch(case) == {"inlet": [1], "walls": list(range(2, 11))}


@pytest.mark.parametrize(
    ("written", "name"),
    [("wall(1)", "wall(1)"), ('"back side"', "back side"), ("div(U,(p))", "div(U,(p))"), ("2d", "2d")],
)
def test_names_of_patches(tmp_path: Path, written: str, name: str) -> None:
    case = foam(tmp_path)
    change(case, "boundary", "inlet", written)
    assert faces_by_patch(case)[name] == [1]


@pytest.mark.parametrize(
    ("old", "new", "says"),
    [
        ("startFace 1;", "", "patch 'inlet' must lie within 11 faces, given startFace none, nFaces 1"),
        ("nFaces 1;", "nFaces 1.5;", "given startFace 1, nFaces 1.5"),
        ("startFace 1;", "startFace 0;", "face 0 of patch 'inlet' lies between two cells"),
        ("nFaces 1;", '#include "x" nFaces 1;', "directives such as '#include' are not supported"),
        ("walls", "inlet", "two entries have the name 'inlet'"),
        ("2\n(", "3\n(", "3 entries are declared, but 2 follow"),
        ("walls", "/* walls", r"line \d+: unterminated comment"),
        ("walls", '"walls', r"line \d+: unterminated string"),
        ("startFace 2;", "startFace 2", r"line \d+: expected a value or ;, found '}'"),
        ("walls\n{", "walls\n", "expected { after the name 'walls', found 'type'"),
        ("nFaces 1;", "a" + " {a" * 60, "nested more than 50 deep"),
        ("nFaces 1;", "a 99999999{1};", "a list of 99999999 equal labels is too long"),
        ("\n)\n", "\n", "found the end of the file: truncated"),
    ],
)
def test_broken_dictionaries(tmp_path: Path, old: str, new: str, says: str) -> None:
    case = foam(tmp_path)
    change(case, "boundary", old, new)
    with pytest.raises(FileError, match=f"case.foam: boundary: .*{says}"):
        read(case)


@pytest.mark.parametrize(
    "zone",
    [
        "type cellZone; inGroups 1(fluid); cellLabels List<label> 1(1);",
        "type cellZone; cellLabels 1(1);",
        "cellLabels List<label> /* 2(0 1) */ 1 ( // 0\n 1 ); type cellZone;",
        "type cellZone; cellLabels (1);",
        "type cellZone; cellLabels List<label> 1{1};",
        "type cellZone; // cellLabels List<label> 1(0);\n cellLabels List<label> 1(1); flip no;",
    ],
)
def test_forms_of_zones(tmp_path: Path, zone: str) -> None:
    case = foam(tmp_path)
    text = f"{HEAD}3\n(\nrotor(1) {{ {zone} }}\nnone {{ type cellZone; cellLabels List<label> 0(); }}\n"
    (poly(case) / "cellZones").write_text(text + "no { type cellZone; cellLabels List<label> 0; } )\n")
    tags = read(case).cell_tags
    assert {name: tag.tolist() for name, tag in tags.items()} == {
        "rotor(1)": [0, 1],
        "none": [0, 0],
        "no": [0, 0],
    }
    change(case, "cellZones", zone, "type cellZone;")
    with pytest.raises(FileError, match=r"cellZones: 'rotor\(1\)' has no list cellLabels"):
        read(case)


@pytest.mark.parametrize("label", [32, 64])
def test_binary_zones_and_empty_lists(tmp_path: Path, label: int) -> None:
    """Labels may hold any byte; an empty list is its length alone."""
    head = f'FoamFile {{ format binary; arch "LSB;label={label};scalar=64"; class regIOobject; }}\n'
    case = foam(tmp_path)
    cells = np.array([1, 0], f"<i{label // 8}").tobytes()
    zones = b"a { type cellZone; cellLabels List<label> 2(" + cells + b"); }\n"
    zones += b"b { type cellZone; cellLabels List<label> 0; }\n"
    (poly(case) / "cellZones").write_bytes(head.encode() + b"2(" + zones + b")\n")
    tags = read(case).cell_tags
    assert {name: tag.tolist() for name, tag in tags.items()} == {"a": [1, 1], "b": [0, 0]}
    (poly(case) / "cellZones").write_bytes(head.encode() + b"0\n// ***")
    assert read(case).cell_tags == {}
    write(tmp_path / "one.foam", samples.boxes(1))
    for text in ("0\n", "0()\n", "0\n\n// *** (\n"):
        (poly(case) / "neighbour").write_text(head + text)
        assert read(tmp_path / "one.foam").n_cells == 1


def test_paths_of_a_case(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    case = foam(tmp_path / "pipe")
    whole = read(case)
    (tmp_path / "pipe" / "pipe.OpenFOAM").touch()
    for path in (
        tmp_path / "pipe",
        tmp_path / "pipe" / "constant",
        poly(case),
        poly(case) / "owner",
        tmp_path / "pipe" / "pipe.OpenFOAM",
    ):
        mesh = read(path)
        assert (mesh.name, mesh.fingerprint) == ("pipe", whole.fingerprint)
        assert read_hierarchy(path)[1] is None
    monkeypatch.chdir(poly(case))
    assert read(".").name == "pipe"
    (tmp_path / "empty.vtu").mkdir()
    with pytest.raises(FileError, match=r"empty\.vtu: is a folder, expected a file"):
        read(tmp_path / "empty.vtu")


def test_command_line_on_a_folder(tmp_path: Path, agglo: Agglo) -> None:
    foam(tmp_path / "pipe")
    assert agglo("run", str(tmp_path / "pipe"), "--parts", "2", "-o", str(tmp_path / "o.npz")).code == 0
    assert read(tmp_path / "o.npz").n_cells == 2


def test_a_folder_is_no_output(tmp_path: Path) -> None:
    with pytest.raises(FileError, match=r"expected a file name such as .*/out\.vtu .* case .*/out\.foam\)"):
        write(tmp_path, samples.boxes(1))
    write(tmp_path / "out.foam", samples.boxes(1))
    assert read(tmp_path).n_cells == 1


def test_regions_of_a_case(tmp_path: Path) -> None:
    case = foam(tmp_path)
    for region in ("fluid", "solid"):
        (tmp_path / "constant" / region).mkdir()
    poly(case).rename(tmp_path / "constant" / "fluid" / "polyMesh")
    (tmp_path / "constant" / "solid" / "polyMesh").mkdir()
    for path in ("fluid", "fluid/polyMesh", "fluid/polyMesh/owner"):
        mesh = read(tmp_path / "constant" / path)
        assert (mesh.name, mesh.n_cells) == ("fluid", 2)
    for whole in (case, tmp_path):
        with pytest.raises(FileError, match=r"the regions fluid, solid; read one .*/constant/fluid"):
            read(whole)


def decomposed(folder: Path, *, addressing: bool = True) -> Path:
    """The two cubes on two processors, the second cube on processor 0."""
    case = foam(folder)
    shutil.rmtree(folder / "constant")
    loops = [[int(v) for v in row[2:-1].split()] for row in CUBES["faces"]]
    outer = {0: loops[6:], 1: loops[1:6]}
    between = {0: [1, 7, 10, 4], 1: loops[0]}  # from the same point on, in opposite directions
    for k in (0, 1):
        faces = [*outer[k], between[k]]
        used = sorted({v for loop in faces for v in loop})
        number = {v: i for i, v in enumerate(used)}
        inlet, walls = ((0, 5), (0, 5)), ((0, 1), (1, 4))
        patches = [
            f"{name} {{ type patch; startFace {start}; nFaces {count}; }}"
            for name, (start, count) in zip(("inlet", "walls"), (inlet, walls)[k], strict=True)
            if (k, name) != (0, "inlet")
        ]
        ends = f"myProcNo {k}; neighbProcNo {1 - k}; startFace 5; nFaces 1;"
        patches.append(f"procBoundary{k}to{1 - k} {{ type processor; {ends} }}")
        rows = {
            "points": [CUBES["points"][v] for v in used],
            "faces": [f"4({' '.join(str(number[v]) for v in loop)})" for loop in faces],
            "owner": ["0"] * 6,
            "neighbour": [],
            "boundary": patches,
            "cellZones": [f"right {{ type cellZone; cellLabels List<label> {('1(0)', '0')[k]}; }}"],
        } | ({"cellProcAddressing": [str(1 - k)]} if addressing else {})
        mesh = folder / f"processor{k}" / "constant" / "polyMesh"
        mesh.mkdir(parents=True)
        for name, lines in rows.items():
            (mesh / name).write_text(f"{HEAD}{len(lines)}\n(\n" + "\n".join(lines) + "\n)\n")
    return case


@pytest.mark.parametrize("allow_gaps", [False, True])
@pytest.mark.parametrize("addressing", [False, True])
def test_decomposed_cases_are_joined(tmp_path: Path, addressing: bool, allow_gaps: bool) -> None:
    whole = read(foam(tmp_path / "whole"))
    case = decomposed(tmp_path / "parts", addressing=addressing)
    for path in (case, case.parent):
        mesh = read(path, allow_gaps=allow_gaps)
        assert (mesh.n_cells, mesh.n_faces, mesh.n_points) == (2, 11, 12)
        assert (mesh.face_cells[:, 1] >= 0).sum() == 1
        right = 1 if addressing else 0
        assert mesh.cell_centroids[right].tolist() == pytest.approx([1.5, 0.5, 0.5])
        assert mesh.cell_tags["right"].tolist() == [int(c == right) for c in (0, 1)]
        assert mesh.cell_tags["processor"].tolist() == ([1, 0] if addressing else [0, 1])
        assert mesh.face_tags.keys() == {"inlet", "walls", "patch"}
        for name in ("inlet", "walls"):
            expected = whole.face_centroids[whole.face_tags[name] == 1]
            found = mesh.face_centroids[mesh.face_tags[name] == 1]
            assert sorted(found.tolist()) == sorted(expected.tolist())
    alone = read(case.parent / "processor1")
    assert (alone.n_cells, int((alone.face_tags["procBoundary1to0"] == 1).sum())) == (1, 1)


@pytest.mark.parametrize(
    ("file", "old", "new", "says"),
    [
        (
            "boundary",
            "nFaces 1; }\n)",
            "nFaces 0; }\n)",
            "processor0 has 1 faces to processor 1, which has 0",
        ),
        ("points", "(1 0 0)", "(1 0.1 0)", r"between two processors lies at \[1.0, 0.0, 0.0\] in one and at"),
        ("owner", "6\n", "7\n", "processor1: owner: 7 labels are declared, but 6 follow"),
        ("cellProcAddressing", "(\n0", "(\n1", "cellProcAddressing must number the 2 cells"),
    ],
)
def test_processors_that_do_not_fit(tmp_path: Path, file: str, old: str, new: str, says: str) -> None:
    case = decomposed(tmp_path)
    path = tmp_path / "processor1" / "constant" / "polyMesh" / file
    assert old in path.read_text()
    path.write_text(path.read_text().replace(old, new, 1))
    with pytest.raises(FileError, match=f"case.foam: .*({says})"):
        read(case)
    shutil.rmtree(tmp_path / "processor0")
    with pytest.raises(FileError, match="there are folders up to processor1, but no processor0"):
        read(case)


def test_fields_are_what_readers_of_vtk_and_openfoam_list(tmp_path: Path) -> None:
    """A folder named by a time; class, object and location in the header; all patches of the mesh.

    VTK omits fields whose names end in ``_0``: OpenFOAM's values of one time step earlier.
    """
    mesh = samples.boxes(1).with_face_tags(inlet=lambda x: x[:, 0] == 0)
    write(tmp_path / "m.foam", mesh, agglomerate(mesh, bisector="coordinate", n_parts=1))
    (field,) = (tmp_path / "0").iterdir()
    assert (
        field.read_bytes().split()
        == (
            b"FoamFile { version 2.0; format ascii; class volScalarField; "
            b'note "labels of a level, written by agglo"; location "0"; object level0; } '
            b"dimensions [0 0 0 0 0 0 0]; internalField nonuniform List<scalar> 1 ( 0 ) ; "
            b"boundaryField { inlet { type zeroGradient; } defaultFaces { type zeroGradient; } }"
        ).split()
    )
    boundary = (poly(tmp_path / "m.foam") / "boundary").read_text()
    patches = [line.strip() for line in boundary.splitlines() if line.strip() in ("inlet", "defaultFaces")]
    assert patches == ["inlet", "defaultFaces"]


@pytest.mark.parametrize("compress", [False, True])
def test_vtk_shows_the_levels(tmp_path: Path, compress: bool) -> None:
    vtk = pytest.importorskip("vtk")
    mesh = samples.boxes(3)
    hierarchy = agglomerate(mesh, bisector="coordinate", n_parts=(8, 4, 2))
    write(tmp_path / "m.foam", mesh, hierarchy, compress=compress)
    reader = vtk.vtkOpenFOAMReader()
    reader.SetFileName(str(tmp_path / "m.foam"))
    reader.UpdateInformation()
    names = [reader.GetCellArrayName(i) for i in range(reader.GetNumberOfCellArrays())]
    assert names == ["level0", "level1", "level2"]
    reader.EnableAllCellArrays()
    reader.Update()
    cells = reader.GetOutput().GetBlock(0).GetCellData()
    for name, labels in zip(names, hierarchy.levels, strict=True):
        array = cells.GetArray(name)
        assert [array.GetValue(i) for i in range(array.GetNumberOfValues())] == labels.tolist()


def test_fields_of_the_user_remain(tmp_path: Path) -> None:
    mesh = samples.boxes(3)
    write(tmp_path / "m.foam", mesh, agglomerate(mesh, bisector="coordinate", n_parts=(8, 4)))
    (tmp_path / "0" / "levelSet").write_text("of the user")
    write(tmp_path / "m.foam", mesh, agglomerate(mesh, bisector="coordinate", n_parts=2))
    assert sorted(each.name for each in (tmp_path / "0").iterdir()) == ["level0", "levelSet"]


def test_levels_are_added_to_a_case_whose_mesh_stays(tmp_path: Path) -> None:
    """Types of patches, zones and the order of faces are of the user."""
    file = foam(tmp_path)
    change(file, "boundary", "type patch;\n nFaces 1", "type wall;\n nFaces 1")
    change(file, "boundary", "type patch", "type symmetryPlane")
    (poly(file) / "pointZones").write_text("of the user")
    before = {each.name: each.read_bytes() for each in poly(file).iterdir()}
    mesh = read(file)
    hierarchy = agglomerate(mesh, bisector="coordinate", n_parts=2)
    write(file, mesh, hierarchy)
    assert {each.name: each.read_bytes() for each in poly(file).iterdir()} == before
    back = read_hierarchy(file)[1]
    assert back is not None
    assert back.levels[0].tolist() == hierarchy.levels[0].tolist()
    patches = "".join((tmp_path / "0" / "level0").read_text().split("boundaryField")[1].split())
    assert patches == "{inlet{typezeroGradient;}walls{typesymmetryPlane;}}"


@pytest.mark.parametrize("entity", ["cell", "face"])
def test_a_case_with_other_tags_is_replaced(
    tmp_path: Path, caplog: pytest.LogCaptureFixture, entity: str
) -> None:
    file = foam(tmp_path)
    change(file, "boundary", "type patch", "type wall")
    mesh = read(file)
    outer = np.where(mesh.face_cells[:, 1] < 0, 1, -1)
    changed = mesh.with_tags(low=[1, 0]) if entity == "cell" else replace(mesh, face_tags={"all": outer})
    write(file, changed)
    assert "held another mesh or other tags: all its patches have the type patch now" in caplog.text
    back = read(file)
    assert ("low" in back.cell_tags) == (entity == "cell")
    assert ("all" in back.face_tags) == (entity == "face")


def test_levels_and_tags_are_not_reported_as_zones(tmp_path: Path, caplog: pytest.LogCaptureFixture) -> None:
    mesh = samples.boxes(2).with_tags(rock=np.arange(8), low=lambda x: x[:, 2] < 0.5)
    write(tmp_path / "m.foam", mesh, agglomerate(mesh, bisector="coordinate", n_parts=2))
    with caplog.at_level("INFO", "agglo"):
        assert read(tmp_path / "m.foam").cell_tags.keys() == {"rock", "low", "level_0"}
    assert [line for line in caplog.messages if line.startswith("cells")] == ["cells by name: low (4)"]
