"""Read graphs, vertex coordinates and partitions from METIS text files."""

from __future__ import annotations

import re
from pathlib import Path
from typing import NamedTuple

import numpy as np
from numpy.typing import ArrayLike

from agglo_core.arrays import Float, Int, frozen_float, frozen_int
from agglo_core.errors import FileError
from agglo_core.files.regular import whole_text
from agglo_core.files.text_numbers import integers, line_of, number_rows, reals
from agglo_core.graph import Graph
from agglo_core.io.file_checks import name_in_errors
from agglo_core.mesh.elements import gather


class _Head(NamedTuple):
    """First line of a METIS graph file: counts, and the line layout per vertex."""

    vertices: int
    edges: int
    sizes: int  # 1 if a size comes first
    weights: int  # number of weights that follow
    by_edge: int  # 1 if each neighbour has a weight


class _Rows(NamedTuple):
    """Neighbours of each vertex as CSR, with edge and vertex weights if the file has any."""

    indptr: Int
    indices: Int
    interface: Float | None
    weights: Float | None


def graph_from_metis(path: str | Path, coordinates: ArrayLike | str | Path) -> Graph:
    """Read a graph from a ``.graph`` file, with its vertex and edge weights, if any.

    Parameters
    ----------
    path : path
        A first line ``n m [fmt [ncon]]``, then for each vertex ``[size] [weights] (neighbour [weight])…``,
        numbered from 1. Lines that begin with ``%`` are comments. Of several weights the first is used. In
        Chaco's files the sizes of METIS are names: if the sizes are a permutation of 1 to n, the lines are
        sorted by them.
    coordinates : (n, 2 or 3) float, or path
        Vertex centroids, or a text file with a line per vertex.

    Raises
    ------
    FileError
        With the file name, if it is missing or has another layout.
    MeshError
        If the graph is not symmetric, or the coordinates do not fit.

    Examples
    --------
    >>> import agglo_core as agglo
    >>> from agglo_core.interchange import graph_from_metis
    >>> _ = open("ring.graph", "w").write("3 3\\n2 3\\n1 3\\n1 2\\n")
    >>> graph = graph_from_metis("ring.graph", [[0, 0], [1, 0], [0, 1]])
    >>> agglo.agglomerate(graph, n_parts=3).levels[0]
    array([0, 1, 2])
    """
    file = Path(path)
    with name_in_errors(file):
        numbers, words = _numbers(whole_text(file))
        head = _head(numbers[: words[0]] if len(words) else numbers)
        rows = _rows(head, numbers[words[0] :], _vertex_lines(words[1:], head.vertices))
    places = _coordinates(coordinates, head.vertices)
    with name_in_errors(file):
        return Graph.from_arrays(
            rows.indptr, rows.indices, places, interface=rows.interface, weights=rows.weights
        )


def _numbers(content: bytes) -> tuple[Int, Int]:
    """Return all numbers in a text without comments, and how many of them are in each line."""
    lines = content.split(b"\n")
    comments = [i for i, line in enumerate(lines) if line.lstrip().startswith(b"%")]
    for i in comments:
        lines[i] = b""  # keep the line numbers in errors
    words = np.delete([len(line.split()) for line in lines], comments)
    return integers(b"\n".join(lines) if comments else content), frozen_int(words)


def _head(line: Int) -> _Head:
    head = [int(number) for number in line]
    if not 2 <= len(head) <= 4 or min(head) < 0:
        raise FileError(f"begins with {head}, expected 'vertices edges [format [constraints]]'")
    n, m, form, constraints = [*head, *(0, 1)[len(head) - 2 :]]
    if form > 111 or any(digit not in "01" for digit in str(form)):
        raise FileError(f"unknown METIS format code {form} (expected up to three digits 0 or 1)")
    if n == 0:
        raise FileError("the graph is empty: it has no vertices")
    if constraints < 1:
        raise FileError("0 weights per vertex are declared, expected 1 or more")
    return _Head(n, m, form // 100, form // 10 % 10 * constraints, form % 10)


def _vertex_lines(words: Int, n: int) -> Int:
    """Return how many numbers are in each vertex line.

    Blank lines after the last vertex are ignored.
    """
    filled_lines = np.flatnonzero(words)
    last = max(n, int(filled_lines[-1]) + 1 if len(filled_lines) else 0)
    if len(words) < n or last > n:
        raise FileError(f"{n} vertices are declared, but {min(last, len(words))} lines follow")
    return words[:n]


def _rows(head: _Head, numbers: Int, words: Int) -> _Rows:
    """Decode neighbours and weights from all vertex lines."""
    first, step = head.sizes + head.weights, 1 + head.by_edge
    counts = words - first
    if (counts < 0).any() or (counts % step).any() or counts.sum() != 2 * head.edges * step:
        raise FileError(
            f"{head.edges} edges are declared, but the lines list {counts.sum() // step} neighbours "
            "(expected two per edge)"
        )
    # Separate the values per vertex from the edge entries.
    starts = np.cumsum(words) - words
    is_vertex_data = np.arange(len(numbers)) - np.repeat(starts, words) < first
    entries = numbers[~is_vertex_data].reshape(-1, step)
    offsets = frozen_int(np.concatenate(([0], np.cumsum(counts // step))))
    # Chaco: sort the lines by their names.
    order = np.argsort(numbers[starts]) if head.sizes else np.arange(len(starts))
    if head.sizes and np.array_equal(numbers[starts[order]], np.arange(1, len(starts) + 1)):
        offsets, places = gather(offsets, frozen_int(order))
        entries, starts = entries[places], starts[order]
    if entries[:, 0].min(initial=1) < 1 or entries[:, 0].max(initial=1) > head.vertices:
        raise FileError(f"a vertex has a neighbour outside 1..{head.vertices}")
    return _Rows(
        offsets,
        frozen_int(entries[:, 0] - 1),
        frozen_float(entries[:, 1]) if head.by_edge else None,
        frozen_float(numbers[starts + head.sizes]) if head.weights else None,
    )


def _coordinates(source: ArrayLike | str | Path, n: int) -> ArrayLike:
    if not isinstance(source, str | Path):
        return source
    file = Path(source)
    with name_in_errors(file):
        return places_of(reals(whole_text(file)), n)


def places_of(numbers: Float, n: int) -> Float:
    """Convert consecutive numbers to vertex coordinates ``(n, 2 or 3)``.

    Raises FileError.
    """
    if len(numbers) not in (2 * n, 3 * n):
        raise FileError(f"{len(numbers)} coordinates for {n} vertices, expected 2 or 3 per vertex")
    places: Float = numbers.reshape(n, -1)
    bad = np.flatnonzero(~np.isfinite(places).all(axis=1))
    if len(bad):
        raise FileError(
            f"vertex {bad[0]} has the coordinates {places[bad[0]].tolist()}, expected finite ones"
        )
    return places


def parts_from_metis(path: str | Path) -> Int:
    """Read a partition from a ``.part.K`` file, one part number per line and vertex.

    The file does not declare its length: compare the number of labels with the number of vertices.

    Raises
    ------
    FileError
        With the file name and the line, if a line does not hold one integer of at least 0.

    Examples
    --------
    >>> from agglo_core.interchange import parts_from_metis
    >>> _ = open("mesh.graph.part.2", "w").write("0\\n0\\n1\\n")
    >>> parts_from_metis("mesh.graph.part.2")
    array([0, 0, 1])
    """
    file = Path(path)
    with name_in_errors(file):
        content = whole_text(file)
        labels = frozen_int(number_rows(content, 0, 1, np.int64).ravel())
        if labels.min(initial=0) < 0:
            place = int(np.argmax(labels < 0))
            sign = re.search(rb"-0*[1-9]", content)
            line = line_of(content, sign.start() if sign is not None else 0)
            raise FileError(f"line {line}: vertex {place} is in part {labels[place]}, expected 0 or more")
    return labels
