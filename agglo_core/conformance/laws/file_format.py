"""Laws for file formats: reading, writing and refusals."""

from __future__ import annotations

import os
import re
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import replace
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any

import numpy as np
from scipy.spatial import cKDTree

from agglo_core.conformance.base.case import Case
from agglo_core.conformance.base.law import law
from agglo_core.conformance.base.subject import Subject
from agglo_core.conformance.base.verdict import Broken, require
from agglo_core.conformance.inputs.mesh_cases import bands
from agglo_core.conformance.inputs.questions import answer, digest, in_words, questions, same
from agglo_core.errors import AggloError
from agglo_core.hierarchy import Hierarchy
from agglo_core.mesh import Mesh
from agglo_core.registry.containment import PLUGIN_FAILURES

_EXACT = ("points", "face_offsets", "face_vertices", "face_cells")
_GARBAGE = {
    "an empty file": b"",
    "a file of words": b"This is no mesh.\n" * 40,
    "a file of random bytes": np.random.default_rng(0).bytes(2000),
}


def _writes(subject: Subject) -> bool:
    return subject.has("write")


@law("format")
def suffixes_declared(subject: Subject) -> None:
    """There is at least one suffix, each in lower case with a leading dot."""
    suffixes = subject.suffixes
    wrong = [s for s in suffixes if not (isinstance(s, str) and re.fullmatch(r"\.[^A-Z\s/]+", s))]
    require(
        suffixes and not wrong,
        f"suffixes are {suffixes!r}, expected a tuple such as ('.toy',): lower case, with the dot",
    )


@law("format", when=_writes)
def read_back(subject: Subject) -> None:
    """Reading a written file returns cells, points and cell tags to 1e-12."""
    for case in questions(subject):
        mesh, back = case.given[0], answer(subject, subject.build(), case)
        require(isinstance(back, Mesh), f"on {case.name}: read returned {in_words(back)}, expected a Mesh")
        if differs := _difference(mesh, back):
            raise Broken(
                f"on {case.name}: {differs} after writing and reading: write numbers with 17 digits (repr), "
                "keep the order of the cells, and refuse with an AggloError what the format cannot hold"
            )


@law("format", when=lambda subject: _writes(subject) and _attribute(subject, "lossless"))
def lossless_kept(subject: Subject) -> None:
    """If ``lossless`` is set, every array of the mesh comes back to the last bit, including face tags."""
    for case in questions(subject):
        mesh = _with_face_tags(case.given[0])
        back = answer(subject, subject.build(), Case(case.name, (mesh, case.given[1])))
        changed_arrays = [
            name for name in _EXACT if not np.array_equal(getattr(mesh, name), getattr(back, name))
        ]
        for sort in ("cell_tags", "face_tags"):
            if not same(digest(getattr(mesh, sort)), digest(getattr(back, sort))):
                changed_arrays.append(sort)
        require(
            not changed_arrays,
            f"on {case.name}: {', '.join(changed_arrays)} came back changed: set lossless = False",
        )


@law("format", when=lambda subject: _writes(subject) and subject.has("read_hierarchy"))
def hierarchy_kept(subject: Subject) -> None:
    """If the format has a method read_hierarchy, the labels of every level are read back unchanged."""
    for case in questions(subject):
        mesh, suffix = case.given
        levels = [bands(mesh, 4), bands(mesh, 4) // 2]
        hierarchy = Hierarchy(mesh, mesh.graph, levels, [{"n_parts": 4}, {"n_parts": 2}], nested=True)
        with _folder(case) as folder:
            tool, path = subject.build(), folder / f"mesh{suffix}"
            tool.write(path, mesh, hierarchy)
            result = tool.read_hierarchy(path)
        require(
            isinstance(result, tuple) and len(result) == 2 and isinstance(result[1], Hierarchy),
            f"on {case.name}: read_hierarchy returned {in_words(result)}, expected (mesh, hierarchy)",
        )
        equal = len(result[1].levels) == 2 and all(map(np.array_equal, result[1].levels, levels))
        require(
            equal,
            (
                f"on {case.name}: the labels read differ from those written: keep the order of the levels, "
                "finest first"
            ),
        )


@law("format")
def broken_files_refused(subject: Subject) -> None:
    """A file that is empty, truncated or not a mesh is refused with an AggloError."""
    tool = subject.build()
    for name, content in _GARBAGE.items():
        _require_refused(tool, subject.suffixes[0], name, content, None)
    for case in questions(subject)[:2]:
        with _folder(case) as folder:
            path = folder / f"mesh{case.given[1]}"
            tool.write(path, case.given[0])
            content = path.read_bytes()
        for share in (0.3, 0.6, 0.95):
            cut = content[: int(share * len(content))]
            _require_refused(tool, case.given[1], f"{case.name}, cut short", cut, case.given[0])


@law("format", when=_writes)
def files_left_alone(subject: Subject) -> None:
    """Reading changes no file, and writing creates only files with the given stem and the ``folders``."""
    for case in questions(subject):
        with _folder(case) as folder:
            (folder / "other.txt").write_text("not yours")
            path = folder / f"mesh{case.given[1]}"
            subject.build().write(path, case.given[0])
            folder_names = getattr(subject.build(), "folders", ())
            files = [file for file in folder.iterdir() if not (file.is_dir() and file.name in folder_names)]
            names = sorted(file.name for file in files if not file.name.startswith("mesh"))
            untouched = (folder / "other.txt").read_text() == "not yours"
            require(
                path.is_file() and names == ["other.txt"] and untouched,
                f"on {case.name}: next to {path.name} there is now {', '.join(names)}: write the given "
                "file, and other files only under names that begin with its stem",
            )
            before = _contents(folder)
            subject.build().read(path)
            after = _contents(folder)
            require(before == after, f"on {case.name}: reading changed the folder: open files with 'r' alone")


def _contents(folder: Path) -> dict[Path, tuple[bytes, int]]:
    """Return the content and modification time of every file in a folder."""
    files = [file for file in folder.rglob("*") if file.is_file()]
    return {file: (file.read_bytes(), os.stat(file).st_mtime_ns) for file in files}


def _attribute(subject: Subject, name: str) -> bool:
    try:
        return bool(getattr(subject.build(), name, False))
    except Broken:
        return False


@contextmanager
def _folder(case: Case) -> Iterator[Path]:
    """Yield a temporary folder, and turn exceptions of the component into violations of the law."""
    with TemporaryDirectory() as name:
        try:
            yield Path(name)
        except Broken:
            raise
        except PLUGIN_FAILURES as error:
            raise Broken(f"on {case.name}: it raised {type(error).__name__}: {error}") from error


def _require_refused(tool: Any, suffix: str, name: str, content: bytes, mesh: Mesh | None) -> None:
    """Require that reading an invalid file raises an AggloError.

    A file truncated by trailing blanks may still return the whole mesh.
    """
    with TemporaryDirectory() as folder:
        path = Path(folder) / f"mesh{suffix}"
        path.write_bytes(content)
        try:
            back = tool.read(path)
        except AggloError:
            return
        except PLUGIN_FAILURES as error:
            raise Broken(
                f"on {name}: reading raised {type(error).__name__}: {error}: raise agglo's FileError instead"
            ) from error
    whole = mesh is not None and isinstance(back, Mesh) and not _difference(mesh, back)
    require(
        whole,
        f"on {name}: it was read as {back!r:.60}: check the number of values read, and raise a FileError",
    )


def _with_face_tags(mesh: Mesh) -> Mesh:
    return replace(mesh, face_tags={"boundary": np.where(mesh.face_cells[:, 1] < 0, 3, 0)})


def _difference(mesh: Mesh, back: Mesh) -> str:
    """Describe the first difference between a mesh and the mesh read back.

    Empty if there is none.
    """
    # Cell count and interfaces.
    if (mesh.dim, mesh.n_cells) != (back.dim, back.n_cells):
        return f"{mesh.n_cells} cells in {mesh.dim}-D became {back.n_cells} in {back.dim}-D"
    size = float(np.abs(mesh.points).max())
    links, links_back = mesh.graph.to_scipy(), back.graph.to_scipy()
    if (links.nnz != links_back.nnz) or abs(links - links_back).max() > 1e-11 * size ** (mesh.dim - 1):
        return "the interfaces between cells differ"
    # Geometry of the cells.
    for name, power in (("cell_centroids", 1), ("cell_measures", mesh.dim), ("cell_diameters", 1)):
        if np.abs(getattr(mesh, name) - getattr(back, name)).max() > 1e-11 * size**power:
            return f"{name} differ"
    # Points in use, in any order.
    points, points_back = (m.points[np.unique(m.face_vertices)] for m in (mesh, back))
    if len(points) != len(points_back) or cKDTree(points_back).query(points)[0].max() > 1e-12 * size:
        return "points differ"
    # Cell tags.
    found_tags = {name: tag.tolist() for name, tag in back.cell_tags.items()}
    tags = [name for name, tag in mesh.cell_tags.items() if tag.tolist() != found_tags.get(name)]
    return f"cell tag {tags[0]!r} differs" if tags else ""
