"""Read graphs, vertex coordinates and mappings from Scotch text files."""

from __future__ import annotations

from pathlib import Path

import numpy as np
from numpy.typing import ArrayLike

from agglo_core.arrays import Float, Int, frozen_float, frozen_int
from agglo_core.errors import FileError
from agglo_core.files.regular import text_bytes, whole_text
from agglo_core.files.text_numbers import integers, reals
from agglo_core.graph import Graph
from agglo_core.interchange.metis_read import places_of
from agglo_core.io.file_checks import name_in_errors
from agglo_core.io.text.counted_lists import record_starts
from agglo_core.mesh.elements import gather

_HEAD = 5  # header length: version, vertices, arcs, base, flags


def graph_from_scotch(path: str | Path, coordinates: ArrayLike | str | Path) -> Graph:
    """Read a graph from a ``.grf`` or ``.src`` file, with its vertex and edge weights (loads), if any.

    Parameters
    ----------
    path : path
        Version 0, vertex count, arc count, first number and three flags; then for each vertex
        ``[name] [load] degree ([load] neighbour)…``, with arbitrary line breaks.
    coordinates : (n, 2 or 3) float, or path
        Vertex centroids; Scotch's ``.xyz`` (dimension, vertex count, then a vertex and its
        coordinates per line), or a line of coordinates per vertex.

    Raises
    ------
    FileError
        With the file name, if it is missing or has another layout.
    MeshError
        If the graph is not symmetric, or the coordinates do not fit.

    Examples
    --------
    >>> from pathlib import Path
    >>> rows = "0\\n3 4\\n0 010\\n1 7 1\\n2 7 0 9 2\\n1 9 1\\n"
    >>> _ = Path("path.grf").write_text(rows)
    >>> graph_from_scotch("path.grf", [[0, 0], [1, 0], [2, 0]]).interface.tolist()
    [7.0, 7.0, 9.0, 9.0]
    """
    file = Path(path)
    with name_in_errors(file):
        numbers = integers(text_bytes(file))
        n, base, has_names, has_weights, has_loads = _head(numbers)
        names, loads, indptr, ends, weights = _rows(numbers, n, has_names, has_loads, has_weights)
        names = names - base if has_names else frozen_int(np.arange(n))
        if not np.array_equal(np.sort(names), np.arange(n)):
            raise FileError(f"its vertices are not named {base} to {n - 1 + base}, each once")
        if ends.min(initial=base) < base or ends.max(initial=base) >= n + base:
            raise FileError(f"a vertex has a neighbour outside {base}..{n - 1 + base}")
        order = frozen_int(np.argsort(names))
        indptr, places = gather(indptr, order)
    points = _places(coordinates, n, base)
    with name_in_errors(file):
        return Graph.from_arrays(
            indptr,
            frozen_int(ends[places] - base),
            points,
            interface=frozen_float(weights[places]) if has_weights else None,
            weights=frozen_float(loads[order]) if has_loads else None,
        )


def _head(numbers: Int) -> tuple[int, int, int, int, int]:
    """Return vertex count, first vertex number, and flags for names, edge weights, vertex weights."""
    head = numbers[:_HEAD].tolist()
    if len(head) < _HEAD or head[0] != 0:
        raise FileError(f"begins with {head}, expected 0, the numbers of vertices and arcs, base and flags")
    _, n, arcs, base, flags = head
    if flags not in (0, 1, 10, 11, 100, 101, 110, 111) or base not in (0, 1) or arcs < 0:
        raise FileError(f"base {base}, {arcs} arcs and flags {flags} are not valid in a Scotch graph")
    if n < 1:
        raise FileError("the graph is empty: it has no vertices")
    return n, base, flags // 100, flags // 10 % 10, flags % 10


def _rows(
    numbers: Int, n: int, has_names: int, has_loads: int, has_weights: int
) -> tuple[Int, Int, Int, Int, Int]:
    """Return vertex names, vertex weights, and the neighbours as CSR with edge weights."""
    stream, n_before, step = numbers[_HEAD:], has_names + has_loads, 1 + has_weights

    def ends(window: Int) -> Int:
        stops = np.full(len(window), len(window) + 1)
        degrees = window[n_before:]
        fits = (degrees >= 0) & (degrees <= len(stream))
        reach = np.arange(len(degrees)) + n_before + 1 + step * np.where(fits, degrees, 0)
        stops[: len(degrees)] = np.where(fits, reach, 1 << 60)
        return frozen_int(stops)

    try:
        starts, length = record_starts(stream, n, ends)
    except FileError as error:
        raise FileError(str(error).replace("cell", "vertex")) from None
    # Locate the arcs of each vertex in the stream.
    degrees = stream[starts + n_before]
    arcs = int(numbers[2])
    if length != len(stream) or degrees.sum() != arcs:
        raise FileError(
            f"{arcs} arcs are declared, but the vertices list {degrees.sum()}; {len(stream) - length} left"
        )
    indptr = np.concatenate(([0], np.cumsum(degrees)))
    places = np.repeat(starts + n_before + 1 - step * indptr[:-1], degrees) + step * np.arange(arcs)
    loads = stream[starts + has_names] if has_loads else starts
    return (
        frozen_int(stream[starts]),
        frozen_int(loads),
        frozen_int(indptr),
        frozen_int(stream[places + has_weights]),
        frozen_int(stream[places]),
    )


def _places(source: ArrayLike | str | Path, n: int, base: int) -> ArrayLike:
    if not isinstance(source, str | Path):
        return source
    file = Path(source)
    with name_in_errors(file):
        numbers = reals(whole_text(file))
        dim = int(numbers[0]) if len(numbers) and numbers[0] in (2, 3) else 0
        rows = numbers[2:].reshape(-1, dim + 1) if dim and len(numbers) == 2 + n * (dim + 1) else None
        if rows is None or numbers[1] != n:
            return places_of(numbers, n)
        order = np.argsort(rows[:, 0])
        if not np.array_equal(rows[order, 0], np.arange(base, n + base)):
            raise FileError(f"its vertices are not named {base} to {n - 1 + base}, each once")
        points: Float = places_of(frozen_float(rows[order, 1:].ravel()), n)
        return points


def parts_from_scotch(path: str | Path, *, base: int = 0) -> Int:
    """Read a partition ``(n,)`` from a ``.map`` file.

    It holds the vertex count, then a vertex and its part per line.

    Parameters
    ----------
    path : path
    base : int
        First vertex number, as in the graph file.

    Raises
    ------
    FileError
        With the file name, if it is missing or has another layout.

    Examples
    --------
    >>> from pathlib import Path
    >>> _ = Path("path.map").write_text("3\\n2\\t1\\n0\\t0\\n1\\t1\\n")
    >>> parts_from_scotch("path.map").tolist()
    [0, 1, 1]
    """
    file = Path(path)
    with name_in_errors(file):
        numbers = integers(whole_text(file))
        if not len(numbers) or len(numbers) != 1 + 2 * int(numbers[0]):
            raise FileError(
                f"{max(len(numbers) - 1, 0)} numbers follow the number of vertices, expected two per vertex"
            )
        vertex, part = numbers[1::2], numbers[2::2]
        order = np.argsort(vertex)
        if not np.array_equal(vertex[order], np.arange(base, len(vertex) + base)):
            raise FileError(f"its vertices are not numbered {base} to {len(vertex) - 1 + base}, each once")
        if part.min(initial=0) < 0:
            raise FileError(f"vertex {vertex[int(np.argmin(part))]} has no part")
        return frozen_int(part[order])
