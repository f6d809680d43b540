"""Recognise unsupported file layouts, and suggest a remedy to the user."""

from __future__ import annotations

from collections.abc import Iterator
from itertools import islice
from pathlib import Path

_POLYGONS = "polygons are read from .vtu, .vtkhdf, .typ2, .mat, .vtk, .obj, .off, .ply and .npz"
_UCD_ELEMENTS = ("pt", "line", "tri", "quad", "tet", "pyr", "prism", "hex")
_GMSH_POLYTOPES = ("34", "35")  # Gmsh's element types polygon and polyhedron
_LINES = 2000  # lines to inspect; the first few determine the layout


def why_unread(path: Path) -> str | None:
    """Return why a file cannot be read, and a remedy (``is …; …``), or None for unknown layouts."""
    look = _LOOKS.get(path.suffix.lower())
    try:
        return look(path) if look is not None else None
    except (OSError, ValueError):  # missing file, or an invalid number
        return None


def _ucd(path: Path) -> str | None:
    """Recognise an AVS UCD file: a line with five counts, then the points."""
    lines = _numbers(path)
    head, point = next(lines, []), next(lines, [])
    if len(head) != 5 or len(point) != 4 or not all(word.isdigit() for word in head):
        return None
    return "is an AVS UCD file, but its suffix .inp also belongs to Abaqus and Ansys; rename it to .avs"


def _avs(path: Path) -> str | None:
    """Return an error text for the first cell whose type AVS UCD does not define, or None.

    Cell lines hold a number, a material, a type and the points.
    """
    lines = _words(path, comments="#")
    counts = [int(word) for word in next(lines, [])]
    if len(counts) != 5:
        return None
    for words in islice(lines, counts[0], counts[0] + counts[1]):
        if len(words) > 2 and words[2] not in _UCD_ELEMENTS:
            return (
                f"is an AVS UCD file with {words[2][:20]!r} cells, which AVS UCD does not define; {_POLYGONS}"
            )
    return None


def _gmsh(path: Path) -> str | None:
    if next(_words(path, comments=None), [""])[0] == "$NOD":
        return (
            "is a Gmsh file of version 1, which is not supported; run gmsh OLD.msh -save -format msh41 "
            '-o NEW.msh, or write it from deal.II with GridOut().write_msh(triangulation, "mesh.msh")'
        )
    if not any(kind in _GMSH_POLYTOPES for kind in _gmsh_types(path)):
        return None
    return f"is a Gmsh file with polygons or polyhedra, which are not yet supported there; {_POLYGONS}"


def _gmsh_types(path: Path) -> Iterator[str]:
    """Yield the element types in a Gmsh text file: per block in version 4, per element in version 2."""
    lines = _words(path, comments=None)
    version = next((next(lines, [""])[0] for words in lines if words[0] == "$MeshFormat"), "")
    started = any(words[0] == "$Elements" and next(lines, None) for words in lines)
    for words in lines if started else ():
        if words[0].startswith("$"):
            return
        if version.startswith("2"):
            yield from words[1:2]
        elif len(words) == 4 and words[3].isdigit():
            yield words[2]
            next(islice(lines, int(words[3]) - 1, None), None)  # past the elements of the block


def _words(path: Path, comments: str | None) -> Iterator[list[str]]:
    """Yield the whitespace-separated words of each line, without comments and empty lines."""
    with open(path, encoding="utf-8", errors="replace") as lines:
        for line in lines:
            words = (line.partition(comments)[0] if comments else line).split()
            if words:
                yield words


def _numbers(path: Path) -> Iterator[list[str]]:
    return islice(_words(path, comments="#"), _LINES)


_LOOKS = {
    ".avs": _avs,
    ".inp": _ucd,
    ".msh": _gmsh,
}
