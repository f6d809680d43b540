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

from agglo_core.arrays import frozen_int
from agglo_core.conformance.base import Broken, Case, Subject, in_words, law, require
from agglo_core.conformance.inputs.drawn import drawn_labels
from agglo_core.conformance.inputs.questions import REFUSED, answer, digest, questions, same
from agglo_core.conformance.inputs.solver_cases import on_levels
from agglo_core.conformance.inputs.strategies import format_cases
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
_LAST = 1000  # bytes at the end of a file, where tags often are: thorough checks cut at each


def _writes(subject: Subject) -> bool:
    return subject.has("write")


def _drawn(subject: Subject) -> Any:
    """Return the strategy of drawn meshes, for the first suffix that the format writes."""
    accepted = questions(subject)
    return format_cases(accepted[0].given[1] if accepted else subject.suffixes[0])


@law("format")
def suffixes_declared(subject: Subject) -> None:
    """There is at least one suffix, each in lower case with a leading dot."""
    suffixes = subject.suffixes
    wrong = [s for s in suffixes if not (isinstance(s, str) and re.fullmatch(r"\.[^A-Z\s/]+", s))]
    require(
        suffixes and not wrong,
        f"suffixes are {suffixes!r}, expected a tuple such as ('.toy',): lower case, with the dot",
    )


@law("format", draw=_drawn, fixed=questions, when=_writes)
def read_back(subject: Subject, case: Case) -> None:
    """A written mesh is read back to 1e-12 with all cell tags, to the last bit if ``lossless`` is set."""
    tool, mesh = subject.build(), case.given[0]
    back = answer(subject, case, tool, refusal=REFUSED)
    if back is REFUSED:
        return
    require(isinstance(back, Mesh), f"read returned {in_words(back)}, expected a Mesh")
    differs = _difference(mesh, back)
    require(
        not differs,
        f"{differs} after writing and reading: write numbers with 17 digits (repr), keep the order of the "
        "cells and the names of tags, and refuse with an AggloError what the format cannot hold",
    )
    if mesh.cell_tags or mesh.face_tags:
        untagged = replace(mesh, cell_tags={}, face_tags={})
        later = answer(subject, replace(case, given=(untagged, case.given[1])), tool)
        stale = sorted((mesh.cell_tags.keys() & later.cell_tags) | (mesh.face_tags.keys() & later.face_tags))
        require(
            not stale,
            f"a file without tags, read later, has the tag {stale[:1]} of this mesh: keep nothing of a file "
            "in self, in the module or in a default argument",
        )
    if getattr(tool, "lossless", False):
        changed = [name for name in _EXACT if not np.array_equal(getattr(mesh, name), getattr(back, name))]
        for tags in ("cell_tags", "face_tags"):
            if not same(digest(getattr(mesh, tags)), digest(getattr(back, tags))):
                changed.append(tags)
        require(not changed, f"{', '.join(changed)} came back changed: set lossless = False")


@law("format", draw=_drawn, fixed=questions, examples=20, when=_writes)
def hierarchy_kept(subject: Subject, case: Case) -> None:
    """A written hierarchy is read back by read_hierarchy, or as cell tags level_0, …, or else refused."""
    mesh = case.given[0]
    for nested in (True, False):
        fine = drawn_labels(mesh.graph, "strips", 4)
        coarse = fine // 2 if nested else frozen_int(np.arange(mesh.n_cells) % 2)
        _require_kept(subject, case, on_levels(mesh, fine, coarse, nested=nested))


def _require_kept(subject: Subject, case: Case, hierarchy: Hierarchy) -> None:
    mesh, suffix = case.given
    with _folder(case) as folder:
        tool, path = subject.build(), folder / f"mesh{suffix}"
        try:
            tool.write(path, mesh, hierarchy)
        except AggloError:
            return
        if subject.has("read_hierarchy"):
            result = tool.read_hierarchy(path)
            require(
                isinstance(result, tuple) and len(result) == 2,
                f"read_hierarchy returned {in_words(result)}, expected (mesh, hierarchy)",
            )
            read = [] if result[1] is None else list(result[1].levels)
        else:
            tags = tool.read(path).cell_tags
            read = [tags[f"level_{level}"] for level in range(2) if f"level_{level}" in tags]
    require(
        len(read) == 2 and all(map(np.array_equal, read, hierarchy.levels)),
        f"{len(read)} levels with other labels were read back, 2 were written: keep the order of the "
        "levels, finest first, or refuse a hierarchy with a FileError",
    )


@law("format")
def broken_files_refused(subject: Subject) -> None:
    """A file that is empty, not a mesh, or cut short is refused with an AggloError, or read unchanged."""
    tool = subject.build()
    for name, content in _GARBAGE.items():
        _require_refused(tool, subject.suffixes[0], name, content, None)
    for case in questions(subject)[:2]:
        mesh, suffix = case.given
        with _folder(case) as folder:
            tool.write(folder / f"mesh{suffix}", mesh)
            content = (folder / f"mesh{suffix}").read_bytes()
        for end in _cuts(len(content), subject.thorough):
            _require_refused(tool, suffix, f"{case.name}, cut after {end} bytes", content[:end], mesh)


def _cuts(size: int, thorough: bool) -> list[int]:
    """Return places in the whole file, and more of them the nearer to its end."""
    near = range(max(size - _LAST, 1), size)
    return sorted({*range(1, size, size // 20 + 1), *near[:: 1 if thorough else 25], *near[-20:]})


@law("format", fixed=questions, when=_writes)
def files_left_alone(subject: Subject, case: Case) -> None:
    """Reading changes no file, and writing creates only files with the given stem and the ``folders``."""
    tool = subject.build()
    with _folder(case) as folder:
        path = folder / f"mesh{case.given[1]}"
        (folder / "other.txt").write_text("not yours")
        tool.write(path, case.given[0])
        new = {file.name for file in folder.iterdir() if not file.name.startswith("mesh")}
        new -= {"other.txt", *getattr(tool, "folders", ())}
        require(
            path.is_file() and not new and (folder / "other.txt").read_text() == "not yours",
            f"next to {path.name} there is now {', '.join(new)}: write the given file, and other files only "
            "under names that begin with its stem",
        )
        before = _contents(folder)
        tool.read(path)
        require(before == _contents(folder), "reading changed the folder: open files with 'r' alone")


def _contents(folder: Path) -> dict[Path, tuple[bytes, int]]:
    """Return the content and modification time of every file in a folder."""
    files = [file for file in folder.rglob("*") if file.is_file()]
    return {file: (file.read_bytes(), os.stat(file).st_mtime_ns) for file in files}


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

    A file cut within trailing blanks, or at a line end before whole tags, may still return the mesh.
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
    whole = False
    if mesh is not None and isinstance(back, Mesh):
        kept = {name: tag for name, tag in mesh.cell_tags.items() if name in back.cell_tags}
        whole = not _difference(replace(mesh, cell_tags=kept), back)
    require(
        whole,
        f"on {name}: it was read as {back!r:.60}: check the number of values read, require a mark or line "
        "end after the last one, and raise a FileError",
    )


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
    if tags:
        return f"cell tag {tags[0]!r} differs"
    # Face tags, if they are kept at all. A face without a tag may have the value 0 or -1.
    if len(mesh.face_centroids) == len(back.face_centroids):
        place = cKDTree(back.face_centroids).query(mesh.face_centroids)[1]
        for name in mesh.face_tags.keys() & back.face_tags.keys():
            written, found = mesh.face_tags[name], back.face_tags[name][place]
            if not np.array_equal(np.where(written == -1, 0, written), np.where(found == -1, 0, found)):
                return f"face tag {name!r} differs"
    return ""
