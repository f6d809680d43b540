"""Formats of strangers beside agglo's own: who reads, who writes, what is refused and how it is said."""

from __future__ import annotations

import os
import pickle
import re
import subprocess
import sys
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from types import ModuleType, SimpleNamespace
from typing import Any

import meshlane
import numpy as np
import pytest

import agglo_core
from agglo_core import (
    Component,
    FileError,
    Hierarchy,
    MeshError,
    OptionError,
    PluginError,
    Registry,
    builtin,
    hookimpl,
)
from agglo_core.errors import AggloError
from agglo_core.io import (
    Meshlane,
    Npz,
    Vtu,
    check_writable,
    file_checks,
    read,
    read_hierarchy,
    write,
)
from agglo_core.mesh import Mesh
from agglo_core.samples import boxes, squares


class Toy:
    """Squares in a row, as text: their number, then the labels of each level, one a line."""

    suffixes: tuple[str, ...] = (".toy",)
    lossless = False

    def read(self, path: Path) -> Mesh:
        words = path.read_text().split()
        if not words[0].isdigit():
            raise FileError(f"begins with {words[0]!r}, expected a number of squares")
        return squares(int(words[0]))

    def write(self, path: Path, mesh: Mesh, hierarchy: Hierarchy | None = None) -> None:
        lines = [str(round(mesh.n_cells**0.5))]
        lines += [" ".join(map(str, labels)) for labels in (hierarchy.levels if hierarchy else ())]
        path.write_text("\n".join(lines))

    def read_hierarchy(self, path: Path) -> tuple[Mesh, Hierarchy | None]:
        mesh = self.read(path)
        levels = [np.array(line.split(), np.int64) for line in path.read_text().splitlines()[1:]]
        if not levels:
            return mesh, None
        return mesh, Hierarchy(mesh, mesh.graph, levels, [{"toy": 1}] * len(levels), True, {})


class Reader:
    """Reads whatever ``answer`` makes of a path, and writes nothing."""

    suffixes: tuple[str, ...] = (".toy",)
    lossless = False
    answer: Callable[[Path], Any] = staticmethod(lambda path: squares(1))

    def read(self, path: Path) -> Any:
        return type(self).answer(path)


class Merging(Reader):
    def __init__(self, merge_points: bool = True) -> None:
        self.merge_points = merge_points

    def read(self, path: Path) -> Any:
        return squares(2 if self.merge_points else 3)


HOME = ModuleType("formats_of_a_test")
"""Where the registry finds the classes of a test."""

sys.modules[HOME.__name__] = HOME


def plugin(**targets: type | str) -> object:
    """A plugin whose formats are classes, or targets."""

    def component(name: str, target: type | str) -> Component:
        if isinstance(target, type):
            place = f"Format{len(vars(HOME))}"
            setattr(HOME, place, target)
            target = f"{HOME.__name__}:{place}"
        return Component("format", name, target)

    declared = [component(name, target) for name, target in targets.items()]

    class Declared:
        @hookimpl
        def agglo_components(self) -> list[Component]:
            return declared

    return Declared()


def having(**targets: type | str) -> Registry:
    """A registry with agglo's own formats and these of one stranger."""
    registry = Registry()
    registry.register(builtin, "defaults", distribution="agglo", version="1")
    registry.register(plugin(**targets), "mine", distribution="my-dist", version="2")
    return registry


def reading(answer: Callable[[Path], Any], **attributes: Any) -> type:
    return type("Reading", (Reader,), {"answer": staticmethod(answer), **attributes})


def refusing(error: Exception) -> Callable[[Path], Any]:
    def answer(path: Path) -> Any:
        raise error

    return answer


@pytest.fixture
def toy(tmp_path: Path) -> Path:
    file = tmp_path / "a.toy"
    file.write_text("2")
    return file


# -- a format that reads and writes ------------------------------------------------------------


def test_a_strangers_format_reads_and_writes(tmp_path: Path) -> None:
    registry, file = having(toy=Toy), tmp_path / "a.TOY"
    mesh = squares(3)
    levels = [np.arange(9) // 3, np.zeros(9, np.int64)]
    check_writable(file, registry=registry)
    write(file, mesh, Hierarchy(mesh, mesh.graph, levels, [{}, {}], True, {}), registry=registry)
    assert os.listdir(tmp_path) == ["a.TOY"]
    assert read(file, registry=registry).fingerprint == mesh.fingerprint
    back, hierarchy = read_hierarchy(file, registry=registry)
    assert hierarchy is not None
    assert hierarchy.fine is back
    assert hierarchy.targets == [{"toy": 1}, {"toy": 1}]
    assert [labels.tolist() for labels in hierarchy.levels] == [level.tolist() for level in levels]
    for use in (check_writable, read):
        with pytest.raises(FileError, match=r"a.TOY: unknown suffix '.TOY'"):
            use(file)  # the program itself does not know it


def test_the_message_of_a_format_follows_the_file_name(toy: Path) -> None:
    toy.write_text("two")
    with pytest.raises(FileError) as caught:
        read(toy, registry=having(toy=Toy))
    assert str(caught.value) == f"{toy}: begins with 'two', expected a number of squares"


def test_empty_files_are_read_only_by_formats_that_declare_it(toy: Path) -> None:
    toy.write_bytes(b"")
    with pytest.raises(FileError, match=r"a.toy: is empty$"):
        read(toy, registry=having(toy=Toy))
    assert read(toy, registry=having(toy=reading(lambda path: squares(1), reads_empty=True))).n_cells == 1


def test_levels_among_the_tags_are_found(toy: Path) -> None:
    tagged = Mesh.from_polygons([[0, 0], [1, 0], [0, 1]], [[0, 1, 2]], cell_tags={"level_0": [0]})
    mesh, hierarchy = read_hierarchy(toy, registry=having(toy=reading(lambda path: tagged)))
    assert hierarchy is not None
    assert mesh.cell_tags == {}


def test_suffixes_may_have_several_dots(tmp_path: Path) -> None:
    registry = having(toy=reading(lambda path: squares(2), suffixes=(".toy.gz",)))
    for name in ("a.toy.gz", "a.gz", ".toy.gz"):
        (tmp_path / name).write_text("1")
    assert read(tmp_path / "a.toy.gz", registry=registry).n_cells == 4
    for name in ("a.gz", ".toy.gz"):
        with pytest.raises(FileError, match=r"unknown suffix '.gz'; the command 'agglo formats' lists"):
            read(tmp_path / name, registry=registry)


# -- several formats of one suffix -------------------------------------------------------------


def test_own_formats_come_before_plugins_and_the_last_resort_after(tmp_path: Path) -> None:
    asked: list[str] = []

    def answer(path: Path) -> Mesh:
        asked.append(path.suffix)
        return squares(1)

    registry = having(mine=reading(answer, suffixes=(".vtu", ".vtk")))
    for suffix in (".vtu", ".vtk"):
        write(tmp_path / f"a{suffix}", squares(2))
    assert read(tmp_path / "a.vtu", registry=registry).n_cells == 4
    assert read(tmp_path / "a.vtk", registry=registry).n_cells == 1
    (tmp_path / "b.vtu").write_text("mine")
    assert read(tmp_path / "b.vtu", registry=registry).n_cells == 1
    assert asked == [".vtk", ".vtu"]
    write(tmp_path / "a.vtk", squares(2), registry=registry)  # it does not write: meshlane does
    assert (tmp_path / "a.vtk").read_bytes().startswith(b"# vtk")


def test_a_plugin_format_may_be_a_last_resort(toy: Path) -> None:
    registry = having(
        late=reading(lambda path: squares(1), last_resort=True), early=reading(lambda path: squares(2))
    )
    assert read(toy, registry=registry).n_cells == 4


def test_if_all_refuse_each_is_named(tmp_path: Path) -> None:
    class Own(AggloError):
        pass

    (tmp_path / "a.vtu").write_text("<")
    registry = having(
        mine=reading(refusing(MeshError("cell 3: bad")), suffixes=(".vtu",)),
        other=reading(refusing(Own("no")), suffixes=(".vtu",)),
    )
    with pytest.raises(
        FileError,
        match=r"a.vtu: none of the matching formats could read it: format 'vtu' \(plugin .*\): .*well-formed"
        r".*; format 'mine' \(plugin 'mine', distribution .*\): cell 3: bad; format 'other' \(.*\): no$",
    ):
        read(tmp_path / "a.vtu", registry=registry)


@pytest.mark.parametrize("error", [FileError("no"), MeshError("cell 3"), OptionError("not so")])
def test_if_one_refuses_its_error_stands(toy: Path, error: AggloError) -> None:
    with pytest.raises(type(error), match=f"{error}$"):
        read(toy, registry=having(toy=reading(refusing(error))))


# -- formats that misbehave --------------------------------------------------------------------

WHO = r"a\.toy: format 'toy' \(plugin 'mine', distribution my-dist 2\)"


@pytest.mark.parametrize(
    ("answer", "message"),
    [
        (refusing(KeyError("x")), " raised KeyError: 'x'"),
        (refusing(SystemExit(3)), " raised SystemExit: 3"),
        (refusing(PluginError("its part is bad")), ": its part is bad"),
        (lambda path: None, r": read\(\) returned None, expected a Mesh"),
        (lambda path: squares(1).graph, r": read\(\) returned Graph.*, expected a Mesh"),
    ],
)
def test_other_errors_of_a_format_are_plugin_errors(
    toy: Path, answer: Callable[[Path], Any], message: str
) -> None:
    registry = having(toy=reading(answer), other=reading(lambda path: squares(1)))
    for use in (read, read_hierarchy):
        with pytest.raises(PluginError, match=f"^.*{WHO}{message}"):
            use(toy, registry=registry)


def test_messages_of_the_system_are_unchanged(toy: Path) -> None:
    with pytest.raises(FileError, match=r"a.toy: Permission denied$"):
        read(toy, registry=having(toy=reading(refusing(PermissionError(13, "Permission denied")))))


@pytest.mark.parametrize(
    ("given", "message"),
    [
        (squares(2), r"expected \(mesh, hierarchy\)"),
        ((None, None), "returned None, expected a Mesh"),
        ((squares(2), "levels"), "expected a Hierarchy or None"),
        (
            (squares(2), Hierarchy(squares(1), squares(1).graph, [np.zeros(1, int)], [{}], True)),
            "MeshError: the hierarchy belongs to another mesh",
        ),
    ],
)
def test_hierarchies_are_checked(toy: Path, given: Any, message: str) -> None:
    kind = reading(lambda path: squares(2), read_hierarchy=lambda self, path: given)
    with pytest.raises(PluginError, match=f"{WHO}.*{message}"):
        read_hierarchy(toy, registry=having(toy=kind))


def test_formats_that_cannot_be_built_are_skipped(tmp_path: Path) -> None:
    class Needy(Reader):
        def __init__(self, depth: int) -> None:
            pass

    registry = having(
        absent="no_such_module:Format",
        nothing=type("Nothing", (), {}),
        needy=Needy,
        big=reading(lambda path: squares(1), suffixes=(".VTU",)),
        toy=Toy,
    )
    write(tmp_path / "a.vtk", squares(2), registry=registry)
    assert read(tmp_path / "a.vtk", registry=registry).n_cells == 4
    (tmp_path / "a.lymph").write_text("1")
    with pytest.raises(FileError) as caught:
        read(tmp_path / "a.lymph", registry=registry)
    said = str(caught.value)
    assert said.count("; the command 'agglo formats' lists all; formats that cannot be used: ") == 1
    assert said.count("format 'absent' (") == 1
    for reason in (
        "unknown suffix '.lymph'; the command",
        "'absent' (plugin 'mine', distribution my-dist 2): importing",
        "'nothing' (plugin 'mine', distribution my-dist 2) built",
        "'needy' (plugin 'mine', distribution my-dist 2) needs a value for depth",
        "'big' (plugin 'mine', distribution my-dist 2): its suffix '.VTU' must be a dot and lower-case",
    ):
        assert reason in said


# -- options -----------------------------------------------------------------------------------


def test_merge_points_is_an_option_of_formats(toy: Path) -> None:
    registry = having(toy=Merging)
    assert read(toy, registry=registry).n_cells == 4
    assert read(toy, merge_points=False, registry=registry).n_cells == 9
    with pytest.raises(OptionError, match=r"format 'toy' \(plugin 'mine', .*\) has no option 'merge_points'"):
        read(toy, merge_points=False, registry=having(toy=Toy))
    assert read(toy, merge_points=False, registry=having(toy=Toy, other=Merging)).n_cells == 9


@pytest.mark.parametrize("name", ["m.vtu", "m.vtk", "m.npz"])
def test_our_formats_accept_merge_points(tmp_path: Path, name: str) -> None:
    points = [[0, 0], [1, 0], [0, 1], [1, 0], [1, 1], [0, 1]]
    slit = Mesh.from_polygons(points, [[0, 1, 2], [3, 4, 5]], merge_points=False)
    write(tmp_path / name, slit)
    assert read(tmp_path / name, merge_points=False).n_points == 6
    assert read(tmp_path / name).n_points == (6 if name == "m.npz" else 4)


# -- writing -----------------------------------------------------------------------------------


def test_what_is_only_read_is_not_written(tmp_path: Path) -> None:
    registry = having(toy=Reader)
    for use in (lambda file: check_writable(file, registry=registry), lambda file: write(
        file, squares(1), registry=registry
    )):  # fmt: skip
        with pytest.raises(
            FileError,
            match=r"a.toy: format 'toy' \(plugin 'mine', .*\) can read such files, but not write them; "
            r"the command 'agglo formats' lists all$",
        ):
            use(tmp_path / "a.toy")
    with pytest.raises(FileError, match=r"unknown suffix '.svg'; the command 'agglo formats' lists all$"):
        check_writable(tmp_path / "a.svg")


@pytest.mark.parametrize(
    ("error", "family", "message"),
    [
        (FileError("holds no triangles"), FileError, r"a\.toy: holds no triangles$"),
        (ValueError("x"), PluginError, f"{WHO} raised ValueError: x"),
        (OSError(28, "No space left on device"), FileError, r"a\.toy: No space left on device$"),
        (None, PluginError, rf"{WHO}: write\(\) did not create the file"),
    ],
)
def test_a_failed_write_leaves_all_as_it_was(
    tmp_path: Path, error: Exception | None, family: type[AggloError], message: str
) -> None:
    def half(self: object, path: Path, mesh: Mesh, hierarchy: Hierarchy | None = None) -> None:
        (path.parent / "beside.txt").write_text("half")
        if error is not None:
            path.write_text("half")
            raise error

    (tmp_path / "a.toy").write_text("old")
    with pytest.raises(family, match=message):
        write(tmp_path / "a.toy", squares(2), registry=having(toy=type("Half", (Toy,), {"write": half})))
    assert os.listdir(tmp_path) == ["a.toy"]
    assert (tmp_path / "a.toy").read_text() == "old"


def test_files_beside_it_come_along(tmp_path: Path) -> None:
    def two(self: object, path: Path, mesh: Mesh, hierarchy: Hierarchy | None = None) -> None:
        path.write_text("2")
        path.with_suffix(".txt").write_text("beside")

    write(tmp_path / "a.toy", squares(2), registry=having(toy=type("Two", (Toy,), {"write": two})))
    assert sorted(os.listdir(tmp_path)) == ["a.toy", "a.txt"]


def test_formats_that_stage_their_files_are_given_the_path_itself(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    def no_staging(path: Path) -> None:
        raise AssertionError(path)

    monkeypatch.setattr(file_checks, "staging", no_staging)
    write(tmp_path / "a.toy", squares(2), registry=having(toy=type("Atomic", (Toy,), {"atomic": True})))
    for name in ("a.vtu", "a.npz", "a.vtk"):
        write(tmp_path / name, squares(2))
    assert len(os.listdir(tmp_path)) == 4


def test_level_values_go_only_to_formats_that_keep_them(tmp_path: Path) -> None:
    def four(self: object, path: Path, mesh: Mesh, hierarchy: Hierarchy, values: Any = "none") -> None:
        path.write_text(str(values))

    mesh = squares(2)
    levels = Hierarchy(mesh, mesh.graph, [np.array([0, 0, 1, 1])], [{"parts": 2}], nested=True)
    keeping = type("Keeping", (Toy,), {"write": four, "keeps_level_values": True})
    for atomic in (True, False):
        registry = having(toy=type("Either", (keeping,), {"atomic": atomic}))
        write(tmp_path / "a.toy", mesh, levels, level_values=[{"UF": [1, 2]}], registry=registry)
        assert (tmp_path / "a.toy").read_text() == "[{'UF': [1, 2]}]"
    write(tmp_path / "a.toy", mesh, levels, registry=registry)
    assert (tmp_path / "a.toy").read_text() == "none"
    write(tmp_path / "a.toy", mesh, levels, level_values=[{"UF": [1, 2]}], registry=having(toy=Toy))
    assert (tmp_path / "a.toy").read_text() == "2\n0 0 1 1"


# -- no formats --------------------------------------------------------------------------------


def test_a_registry_without_formats_says_so(toy: Path) -> None:
    for use, verb in ((read, "read"), (check_writable, "write")):
        with pytest.raises(FileError, match=rf"'.toy'; no format can {verb} it: .*s'$"):
            use(toy, registry=Registry())


@pytest.mark.parametrize(
    ("suffix", "nearest"),
    [
        ("vtx", "'.vtu' or '.vtp' or '.vtk'"),
        ("VTX", "'.vtu' or '.vtp' or '.vtk'"),
        ("mhs", "'.msh'?)"),
    ],
)
def test_an_unknown_suffix_names_the_nearest(tmp_path: Path, suffix: str, nearest: str) -> None:
    file = tmp_path / f"a.{suffix}"
    file.write_text("1")
    with pytest.raises(FileError) as caught:
        read(file)
    assert str(caught.value).startswith(f"{file}: unknown suffix '.{suffix}' (did you mean {nearest}")
    assert str(caught.value).endswith("; the command 'agglo formats' lists all")


def test_only_suffixes_that_can_be_written_are_suggested_for_writing(tmp_path: Path) -> None:
    with pytest.raises(FileError, match=r"unknown suffix '.vtx' \(did you mean '.vtu' or '.vtk'\?\)"):
        check_writable(tmp_path / "a.vtx")


def test_blocked_formats_are_named(toy: Path) -> None:
    registry = having(toy=Toy)
    registry.block("mine", "not today")
    with pytest.raises(
        FileError, match=r"unknown suffix '.toy'.*cannot be used: .*format 'toy' \(.*\): blocked: not today$"
    ):
        read(toy, registry=registry)


@pytest.mark.parametrize("command", ["mesh squares:4 -o out.vtu", "quality in.vtu"])
def test_the_program_without_its_own_formats(tmp_path: Path, command: str) -> None:
    write(tmp_path / "in.vtu", squares(2))
    program = [sys.executable, "-m", "agglo_core", *command.split()]
    done = subprocess.run(
        program, cwd=tmp_path, env={**os.environ, "AGGLO_BLOCK": "defaults"}, capture_output=True, text=True,
        check=False,
    )  # fmt: skip
    said = " ".join(done.stderr.split())
    assert done.returncode == 2
    assert "unknown suffix '.vtu'; no format can" in said
    assert "plugins that cannot be used: plugin 'defaults' (distribution agglo" in said
    assert said.endswith("blocked by AGGLO_BLOCK")


# -- our own classes ---------------------------------------------------------------------------


def test_suffixes_are_known_without_the_readers() -> None:
    source = """
import sys
from agglo_core.registry import default
formats = [each.component for each in default().list() if each.kind == "format"]
assert {".vtu", ".npz", ".msh", ".foam"} <= {suffix for each in formats for suffix in each.suffixes}
print([name for name in ("numpy", "scipy", "meshlane", "agglo_core.mesh") if name in sys.modules])
"""
    done = subprocess.run([sys.executable, "-c", source], capture_output=True, text=True, check=True)
    assert done.stdout.strip() == "[]"


def declaring(**suffixes: Any) -> Registry:
    """A registry with agglo's own formats and strangers' that cannot be imported, with these suffixes."""
    registry = Registry()
    registry.register(builtin, "defaults", distribution="agglo", version="1")
    declared = [Component("format", name, "absent:Format", suffixes=own) for name, own in suffixes.items()]
    registry.register(SimpleNamespace(agglo_components=hookimpl(lambda: declared)), "mine")
    return registry


def test_a_format_that_declares_other_suffixes_is_not_built(tmp_path: Path) -> None:
    (tmp_path / "a.toy").write_text("1")
    registry = declaring(other=(".other",))
    with pytest.raises(FileError, match=r"unknown suffix '.toy'.*format 'other' .*: importing its target"):
        read(tmp_path / "a.toy", registry=registry)
    (tmp_path / "a.vtk").write_text("1")
    with pytest.raises(FileError) as caught:
        read(tmp_path / "a.vtk", registry=registry)
    assert "other" not in str(caught.value)


@pytest.mark.parametrize(
    ("suffixes", "says"),
    [
        ([".a"], r"suffixes \['\.a'\] is not a tuple such as"),
        ((".A",), r"suffix '\.A' must be a dot and lower-case"),
        (("a",), r"suffix 'a' must be a dot"),
    ],
)
def test_declared_suffixes_are_checked(suffixes: Any, says: str) -> None:
    (record,) = (each for each in declaring(wrong=suffixes).list() if each.name == "wrong")
    assert record.state == "broken"
    assert re.search(says, record.reason)


def test_only_formats_declare_suffixes() -> None:
    declared = [Component("metric", "wrong", "absent:Metric", suffixes=(".a",))]
    registry = Registry()
    registry.register(SimpleNamespace(agglo_components=hookimpl(lambda: declared)), "mine")
    (record,) = registry.list()
    assert (record.state, record.reason) == ("broken", "suffixes applies to formats only")


def test_a_format_without_suffixes_says_so(tmp_path: Path) -> None:
    registry = having(bare=reading(lambda path: squares(1), suffixes=()))
    with pytest.raises(FileError, match=r"format 'bare' .*: its suffixes are \(\), expected a tuple such as"):
        check_writable(tmp_path / "a.toy", registry=registry)


def test_strangers_are_not_imported_where_ours_read(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    (tmp_path / "late_format.py").write_text("Format = None")
    monkeypatch.syspath_prepend(tmp_path)
    registry = having(mine="late_format:Format")
    write(tmp_path / "a.vtu", squares(2), registry=registry)
    assert read(tmp_path / "a.vtu", registry=registry).n_cells == 4
    assert "late_format" not in sys.modules
    with pytest.raises(FileError, match=r"format 'mine' \(.*\): its target is None, expected a class"):
        check_writable(tmp_path / "a.xyz", registry=registry)
    monkeypatch.delitem(sys.modules, "late_format")


def test_the_suffixes_are_those_that_meshlane_reads() -> None:
    known = {suffix for suffix in meshlane.extension_to_filetypes if suffix.count(".") == 1}
    registry = agglo_core.registry.default()
    declared = {name: registry.record("format", name).component for name in ("vtu", "openfoam", "meshlane")}
    ours = {
        ".svg",
        ".ele",
        ".node",
        ".ply",
        ".off",
        ".obj",
    }  # the first is only drawn, the others are read by formats of agglo
    others = {".openfoam"}  # of ParaView's second reader of such cases
    found = [suffix for each in declared.values() if each is not None for suffix in each.suffixes]
    assert {*found, *ours} - others == known


@pytest.mark.parametrize("kind", [Vtu, Npz, Meshlane])
def test_ours_can_be_used_by_themselves(kind: type, tmp_path: Path) -> None:
    tool = pickle.loads(pickle.dumps(kind(merge_points=False)))
    assert not tool.merge_points
    file = tmp_path / f"a{'.vtk' if kind is Meshlane else f'.{kind.__name__.lower()}'}"
    tool.write(file, squares(3))
    assert tool.read(file).n_cells == 9


@pytest.mark.parametrize("name", ["vtu", "npz"])
def test_promises_of_three_dimensions_hold(name: str, tmp_path: Path) -> None:
    tool = agglo_core.registry.default().build("format", name)
    tool.write(tmp_path / f"a.{name}", boxes(2))
    assert tool.read(tmp_path / f"a.{name}").n_cells == 8


def test_an_openfoam_case_is_read_by_its_marker(tmp_path: Path) -> None:
    case = tmp_path / "constant" / "polyMesh"
    case.mkdir(parents=True)
    head = "FoamFile\n{{ version 2.0; format ascii; class {}; object {}; }}\n"
    points = [(x, y, z) for z in (0, 1) for y in (0, 1) for x in (0, 1)]
    faces = [(0, 2, 3, 1), (4, 5, 7, 6), (0, 1, 5, 4), (2, 6, 7, 3), (0, 4, 6, 2), (1, 3, 7, 5)]
    for name, kind, lines in (
        ("points", "vectorField", [f"({x} {y} {z})" for x, y, z in points]),
        ("faces", "faceList", [f"4({a} {b} {c} {d})" for a, b, c, d in faces]),
        ("owner", "labelList", ["0"] * 6),
        ("neighbour", "labelList", []),
        ("boundary", "polyBoundaryMesh", ["walls { type wall; nFaces 6; startFace 0; }"]),
    ):
        count = len(lines)
        (case / name).write_text(head.format(kind, name) + f"{count}\n(\n" + "\n".join(lines) + "\n)\n")
    (tmp_path / "case.foam").write_bytes(b"")
    assert read(tmp_path / "case.foam").cell_measures == pytest.approx([1.0])


# -- content ---------------------------------------------------------------------------------------


@pytest.mark.usefixtures("forked_readers")
@pytest.mark.parametrize("suffix", [".vtu", ".npz", ".typ2", ".mat", ".off"])
@pytest.mark.parametrize("name", ["m.dat2", "m", "m.vtk"])
def test_content_is_recognised_under_a_wrong_suffix(tmp_path: Path, suffix: str, name: str) -> None:
    write(tmp_path / f"m{suffix}", squares(3))
    (tmp_path / f"m{suffix}").rename(tmp_path / name)
    assert read(tmp_path / name).n_cells == 9


def test_strangers_formats_recognise_content_too(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """By the method where no suffixes are declared, by the declaration otherwise."""
    (tmp_path / "a.dat2").write_text("MINE 2")
    mine = reading(lambda path: squares(2), recognises=lambda self, head: head.startswith(b"MINE"))
    assert read(tmp_path / "a.dat2", registry=having(mine=mine)).n_cells == 4
    monkeypatch.setattr(HOME, "Declared", reading(lambda path: squares(3)), raising=False)
    for magic, found in ((r"\AMINE\s", True), (r"\AYOURS", False)):
        component = Component("format", "mine", f"{HOME.__name__}:Declared", suffixes=(".mine",), magic=magic)
        registry = Registry()
        registry.register(SimpleNamespace(agglo_components=hookimpl(lambda own=component: [own])), "mine")
        if found:
            assert read(tmp_path / "a.dat2", registry=registry).n_cells == 9
        else:
            with pytest.raises(FileError, match=r"unknown suffix '\.dat2'"):
                read(tmp_path / "a.dat2", registry=registry)


@pytest.mark.parametrize(
    ("declared", "says"),
    [
        ({"magic": "("}, "magic applies to formats with declared suffixes"),
        ({"magic": "(", "suffixes": (".a",)}, r"magic '\(' is not a regular expression of bytes"),
        ({"magic": b"A", "suffixes": (".a",)}, r"magic b'A' is not a regular expression of bytes"),
        ({"magic": "€", "suffixes": (".a",)}, "magic '€' is not a regular expression of bytes"),
    ],
)
def test_declared_magic_is_checked(declared: dict[str, Any], says: str) -> None:
    components = [Component("format", "wrong", "absent:Format", **declared)]
    registry = Registry()
    registry.register(SimpleNamespace(agglo_components=hookimpl(lambda: components)), "mine")
    (record,) = registry.list()
    assert record.state == "broken"
    assert re.search(says, record.reason)


def test_what_is_recognised_and_broken_is_refused_with_both_reasons(tmp_path: Path) -> None:
    (tmp_path / "m.dat2").write_text("OFF\n3 1 0\n0 0 0\n")
    with pytest.raises(FileError, match=r"m\.dat2: 3 points are declared, but 3 coordinates follow"):
        read(tmp_path / "m.dat2")


_PLANE, _SOLID = (".vtu", ".npz", ".typ2", ".mat", ".off", ".obj"), (".hedra", ".ele", ".ovm", ".foam")
_EXTREME = (2**53 - 1, 2**53, -(2**53) - 1, 2**62, 2**63 - 1, -(2**63), 2**31, -(2**31) - 1)


@pytest.mark.parametrize("suffix", [*_PLANE, *_SOLID])
def test_extreme_values_strange_names_and_far_points_come_back(suffix: str, tmp_path: Path) -> None:
    mesh = boxes(2) if suffix in _SOLID else squares(3)
    rng = np.random.default_rng(0)
    names = [
        "b/a",
        "a b",
        "a_b",
        "ä€𝄞",
        "x" * 60,
        "-1",
        "# cell data: 5",
        "cell data",
        "id",
        "level_x",
        ".",
        ".a",
        "a.gz",
    ]
    tags = {name: rng.choice(_EXTREME, mesh.n_cells) for name in names}
    for scale, shift in ((1e-6, 1.0), (1e8, -1e6), (1e-8, 0.0)):
        far = replace(mesh, points=mesh.points * scale + shift, cell_tags=tags)
        write(tmp_path / f"m{suffix}", far)
        back = read(tmp_path / f"m{suffix}")
        assert {name: tag.tolist() for name, tag in back.cell_tags.items()} == {
            name: tag.tolist() for name, tag in tags.items()
        }
        assert np.array_equal(np.unique(back.points, axis=0), np.unique(far.points, axis=0))


@pytest.mark.parametrize("suffix", [".vtu", ".typ2"])
def test_a_tag_that_hides_cells_is_refused(suffix: str, tmp_path: Path) -> None:
    mesh = squares(2).with_tags(vtkGhostType=[0, 1, 0, 0])
    with pytest.raises(MeshError, match="'vtkGhostType' is reserved for marking copies of other cells"):
        write(tmp_path / f"m{suffix}", mesh)
