"""Convert agglo's graphs to networkx graphs and back, with all node and edge data."""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray
from scipy import sparse

from agglo_core.arrays import Float, frozen_float, frozen_index, frozen_int
from agglo_core.errors import MeshError
from agglo_core.graph import Graph

if TYPE_CHECKING:
    import networkx as nx

_RESERVED = ("centroid", "measure", "boundary", "weight", "vertices")


def graph_to_networkx(graph: Graph) -> nx.Graph:
    """Convert a graph to an undirected networkx graph with plain Python values, ready for JSON.

    Node i, 0..n−1, has the attributes ``centroid`` (relative to ``G.graph["origin"]``, usable as ``pos=`` for
    drawing), ``measure``, ``boundary``, ``weight``, ``vertices`` (rows of ``G.graph["points"]``) and one
    attribute per entry of ``graph.data``. Each edge has ``interface``. ``G.graph`` holds ``origin``,
    ``points``, block ``offsets``, and the dtypes of ``data``.

    Raises
    ------
    MeshError
        If an entry of ``data`` has the name of such an attribute.

    Examples
    --------
    >>> from agglo_core import samples
    >>> graph_to_networkx(samples.squares(2).graph).edges[0, 1]
    {'interface': 0.5}
    """
    import networkx as nx

    clashes = [name for name in graph.data if name in _RESERVED]
    if clashes:
        raise MeshError(f"data {clashes[0]!r} has the name of a node attribute: {', '.join(_RESERVED)}")
    # Node and graph attributes as plain Python values.
    columns: dict[str, list[Any]] = {
        "centroid": graph.centroids.tolist(),
        "measure": graph.measures.tolist(),
        "boundary": graph.boundary.tolist(),
        "weight": graph.weights.tolist(),
        "vertices": [row.tolist() for row in np.split(graph.vertices, graph.vertex_offsets[1:-1])],
        **{name: values.tolist() for name, values in graph.data.items()},
    }
    result = nx.Graph(
        origin=graph.origin.tolist(),
        points=graph.points.tolist(),
        offsets=graph.offsets.tolist(),
        data={name: values.dtype.str for name, values in graph.data.items()},
    )
    rows = zip(*columns.values(), strict=True)
    result.add_nodes_from((i, dict(zip(columns, row, strict=True))) for i, row in enumerate(rows))
    # Each edge once.
    start = np.repeat(np.arange(graph.n), np.diff(graph.indptr))
    is_upper = start < graph.indices
    edges = (start[is_upper].tolist(), graph.indices[is_upper].tolist(), graph.interface[is_upper].tolist())
    result.add_weighted_edges_from(zip(*edges, strict=True), weight="interface")
    return result


def graph_from_networkx(
    network: nx.Graph,
    *,
    centroid: str = "centroid",
    interface: str = "interface",
    measure: str = "measure",
    weight: str = "weight",
    boundary: str = "boundary",
    data: Iterable[str] | None = None,
) -> Graph:
    """Convert a networkx graph to agglo's graph, with nodes numbered in the order of ``network.nodes``.

    Results of :func:`graph_to_networkx` are restored bit by bit, with neighbours in ascending order. Other
    graphs need centroids only: interfaces and measures default to 1, weights to the measures, boundaries to
    0, and diameters are those of the centroids.

    Parameters
    ----------
    centroid, interface, measure, weight, boundary : str
        Node attribute names (``interface``: edge attribute); ``centroid`` holds 2 or 3 coordinates,
        relative to ``network.graph["origin"]`` if present.
    data : names, optional
        Node attributes for ``data``; default: those listed in ``network.graph["data"]``.

    Raises
    ------
    MeshError
        For a directed graph, for attributes missing in some nodes or edges (with the first), and for invalid
        values, as :meth:`Graph.from_arrays`.

    Examples
    --------
    >>> there = agglo.samples.squares(2).graph.to_networkx()
    >>> agglo.interchange.graph_from_networkx(there)
    Graph(2-D, 4 nodes, 4 edges)
    """
    if network.is_directed():
        raise MeshError(
            "expected an undirected graph, given a directed one; call network.to_undirected() first"
        )
    if not len(network):
        raise MeshError("the graph is empty: it has no nodes")
    nodes = dict(network.nodes(data=True))
    dtypes: Mapping[str, str] = network.graph.get("data", {})
    centroids = _column(nodes, centroid, None)
    if centroids is None or centroids.ndim != 2 or centroids.shape[1] not in (2, 3):
        problem = "no node has it" if centroids is None else f"given shape {centroids.shape}"
        raise MeshError(f"every node needs the attribute {centroid!r} with 2 or 3 coordinates; {problem}")
    # Optional attributes.
    size = _column(nodes, measure, None)
    size = np.ones(len(nodes)) if size is None else frozen_float(size)
    load = _column(nodes, weight, None)
    exposed = _column(nodes, boundary, None)
    matrix = _adjacency(network, interface)
    return Graph(
        indptr=frozen_int(matrix.indptr),
        indices=frozen_index(matrix.indices),
        interface=matrix.data,
        measures=size,
        weights=size if load is None or np.array_equal(load, size) else load,
        boundary=np.zeros(len(nodes)) if exposed is None else exposed,
        data={name: _data(nodes, name, dtypes.get(name)) for name in (dtypes if data is None else data)},
        **_geometry(network, nodes, centroids),
    )


def _column(nodes: Mapping[Any, Mapping[str, Any]], name: str, dtype: str | None) -> NDArray[Any] | None:
    """Collect an attribute of all nodes in an array, or return None if no node has it.

    Raises MeshError if only some nodes have it.
    """
    lacking = [node for node, attributes in nodes.items() if name not in attributes]
    if len(lacking) == len(nodes):
        return None
    if lacking:
        raise MeshError(f"node {lacking[0]!r} has no attribute {name!r}, but others have")
    try:
        return np.array([attributes[name] for attributes in nodes.values()], dtype=dtype or np.float64)
    except (TypeError, ValueError) as error:
        raise MeshError(f"node attribute {name!r} must be numbers of one shape: {error}") from None


def _data(nodes: Mapping[Any, Mapping[str, Any]], name: str, dtype: str | None) -> NDArray[Any]:
    """Collect a node attribute in an array of the given dtype, by default integers or else reals."""
    whole = all(isinstance(attributes.get(name), int) for attributes in nodes.values())
    values = _column(nodes, name, dtype or ("i8" if whole else "f8"))
    if values is None:
        raise MeshError(f"no node has the attribute {name!r}")
    return values


def _adjacency(network: nx.Graph, name: str) -> sparse.csr_array[Any, Any]:
    """Return the symmetric CSR matrix of edge weights, by default 1.

    The weights of parallel edges are added.
    """
    number = {node: i for i, node in enumerate(network)}
    edges = [(number[a], number[b], value) for a, b, value in network.edges(data=name)]
    lacking = [edge for edge in edges if edge[2] is None]
    if lacking and len(lacking) < len(edges):
        a, b, _ = lacking[0]
        raise MeshError(f"the edge between nodes {a} and {b} has no attribute {name!r}, but others have")
    start, end = (np.array([edge[side] for edge in edges], np.int64) for side in (0, 1))
    try:
        values = np.ones(len(edges)) if lacking else np.array([edge[2] for edge in edges], np.float64)
    except (TypeError, ValueError) as error:
        raise MeshError(f"edge attribute {name!r} must be numbers: {error}") from None
    places = (np.concatenate((start, end)), np.concatenate((end, start)))
    shape = (len(number), len(number))
    return sparse.csr_array(sparse.coo_array((np.tile(values, 2), places), shape=shape))


def _geometry(network: nx.Graph, nodes: Mapping[Any, Mapping[str, Any]], centroids: Float) -> dict[str, Any]:
    """Return points and vertices of the cells, or each centroid as only vertex if none are stored."""
    n, d = centroids.shape
    stored = network.graph
    # Other graphs: each node has its centroid as its only vertex.
    if "points" not in stored or any("vertices" not in attributes for attributes in nodes.values()):
        centre = 0.5 * (centroids.min(axis=0) + centroids.max(axis=0))
        return {
            "centroids": centroids - centre,
            "vertex_offsets": np.arange(n + 1),
            "vertices": np.arange(n),
            "points": centroids - centre,
            "offsets": [0, n],
            "origin": np.asarray(stored.get("origin", np.zeros(d))) + centre,
        }
    # Graphs with stored vertices.
    rows = [np.asarray(attributes["vertices"], np.int64) for attributes in nodes.values()]
    points, vertices = np.array(stored["points"], np.float64).reshape(-1, d), np.concatenate(rows)
    if len(vertices) and not 0 <= vertices.min() <= vertices.max() < len(points):
        raise MeshError(
            f"vertices lie in {vertices.min()}..{vertices.max()}, but there are {len(points)} points"
        )
    whole = list(nodes) == list(range(n)) and stored.get("offsets", [0])[-1] == n
    return {
        "centroids": centroids,
        "vertex_offsets": np.concatenate(([0], np.cumsum([len(row) for row in rows]))),
        "vertices": vertices,
        "points": points,
        "offsets": stored["offsets"] if whole else [0, n],  # a subgraph is one block
        "origin": stored.get("origin", np.zeros(d)),
    }
