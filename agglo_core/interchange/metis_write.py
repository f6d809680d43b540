"""Write graphs and partitions to METIS text files, which KaHIP and Chaco also read."""

from __future__ import annotations

from pathlib import Path

import numpy as np
from numpy.typing import ArrayLike

from agglo_core.arrays import Int, frozen_int
from agglo_core.files.text_numbers import integer_lines
from agglo_core.graph import Graph
from agglo_core.hierarchy import Hierarchy
from agglo_core.io.atomic import staging

_SCALE = 10_000  # largest integer weight after scaling


def graph_to_metis(path: str | Path, graph: Graph) -> None:
    """Write a graph to a METIS file, with vertex and edge weights scaled to integers up to 10,000.

    The file ``PATH.xyz`` beside it holds the centroids, one line per vertex, for ParMETIS and Chaco.

    Examples
    --------
    >>> import agglo_core as agglo
    >>> from agglo_core.interchange import graph_to_metis
    >>> graph_to_metis("mesh.graph", agglo.samples.squares(2).graph)
    >>> print(open("mesh.graph").readline().strip())  # 4 vertices, 4 edges, with weights
    4 4 011
    """
    target = Path(path)
    vertex = _scaled_integers(graph.weights)
    edge = _scaled_integers(graph.interface)
    sizes = np.diff(graph.indptr).astype(np.int64)
    entries = np.stack((graph.indices.astype(np.int64) + 1, edge), axis=1).ravel()
    stream = np.insert(entries, 2 * np.asarray(graph.indptr[:-1], np.int64), vertex)
    offsets = frozen_int(np.concatenate(([0], np.cumsum(2 * sizes + 1))))
    head = f"{len(sizes)} {len(graph.indices) // 2} 011\n"
    with staging(target) as folder:
        (folder / target.name).write_text(head + integer_lines(offsets, frozen_int(stream)))
        points = np.asarray(graph.centroids) + np.asarray(graph.origin)
        np.savetxt(folder / f"{target.name}.xyz", points, fmt="%.17g")


def _scaled_integers(values: ArrayLike) -> Int:
    """Round values to positive integers after scaling the largest to 10,000."""
    array = np.asarray(values, np.float64)
    largest = float(array.max(initial=0.0))
    return frozen_int(np.maximum(1, np.rint(array * (_SCALE / largest)) if largest > 0 else 1))


def parts_to_metis(path: str | Path, hierarchy: Hierarchy) -> list[Path]:
    """Write each level's labels to ``PATH.part.K`` with K parts, and return the file paths.

    Examples
    --------
    >>> import agglo_core as agglo
    >>> from agglo_core.interchange import parts_to_metis
    >>> hierarchy = agglo.agglomerate(agglo.samples.squares(4), n_parts=(4, 2))
    >>> [file.name for file in parts_to_metis("mesh.graph", hierarchy)]
    ['mesh.graph.part.4', 'mesh.graph.part.2']
    """
    target, files = Path(path), []
    for labels in hierarchy.levels:
        count = int(labels.max()) + 1
        file = target.with_name(f"{target.name}.part.{count}")
        with staging(file) as folder:
            (folder / file.name).write_text("".join(f"{label}\n" for label in labels.tolist()))
        files.append(file)
    return files
