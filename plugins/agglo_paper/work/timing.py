"""Measurement of every method's CPU time on one mesh, for one bisection and a full recursion."""

from __future__ import annotations

import time
from collections.abc import Callable, Mapping, Sequence
from functools import partial
from importlib.util import find_spec
from typing import Any, Final

import numpy as np

from agglo_core.authoring import AggloError, Graph, agglomerate, default, samples
from agglo_core.graph.ordering import curve_order

Call = Callable[[], Any]
_NETWORK: Final = "gnn_paper"
_KMEANS: Final = "kmeans_sklearn"
_CELLS_PER_PART = 16


def time_one(kind: str, cells: int, bisectors: Sequence[str], runs: int, seconds: float) -> dict[str, Any]:
    """Return every method's CPU seconds on one Voronoi mesh, and messages of failed methods.

    Each method runs once untimed, then ``runs`` times, or as often as ``seconds`` allow: at least three
    times, or once if a single run takes longer.
    """
    # 1. Mesh and graph
    mesh = samples.voronoi(cells, seed=cells)
    graph = mesh.graph.subgraph(curve_order(mesh.graph.centroids), [0, mesh.n_cells])
    whole = 2 if kind == "bisection" else max(2, cells // _CELLS_PER_PART)
    methods = _metis(graph, whole, kind == "bisection")
    times: dict[str, list[float]] = {}
    failures: dict[str, str] = {}
    # 2. Bisectors through a whole run, then the components alone
    for name in bisectors:
        run = partial(agglomerate, graph, bisector=name, n_parts=whole)
        try:
            times[f"{name}, whole" if kind == "bisection" else name] = _time_calls(run, runs, seconds)
        except AggloError as error:
            failures[name] = str(error)
        else:
            methods |= _bisection_calls(name, graph) if kind == "bisection" else {}
    # 3. Direct calls
    times |= {name: _time_calls(call, runs, seconds) for name, call in methods.items()}
    return {"seconds": times, "failures": failures}


def _time_calls(call: Call, runs: int, seconds: float) -> list[float]:
    start = time.process_time()
    call()
    least = 3 if time.process_time() - start < seconds else 1
    times: list[float] = []
    while len(times) < least or (len(times) < runs and sum(times) < seconds):
        start = time.process_time()
        call()
        times.append(time.process_time() - start)
    return times


def _bisection_calls(name: str, graph: Graph) -> Mapping[str, Call]:
    """Return functions that call one bisector alone, with variants for the paper's two."""
    if name == _KMEANS:
        tools = {"k-means, 1 start": {"n_init": 1}, "k-means, 10 starts": {"n_init": 10}}
        return {
            title: _split(default().build("bisector", name, **how), graph) for title, how in tools.items()
        }
    alone = {name: _split(default().build("bisector", name), graph)}
    if name == _NETWORK:
        network = default().build("bisector", name, precision="single")
        alone["GNN, forward"] = partial(network.logits, graph)
    return alone


def _split(tool: Any, graph: Graph) -> Call:
    if hasattr(tool, "bisect_level"):
        return lambda: tool.bisect_level(graph, np.zeros(1, np.uint64))
    return lambda: tool.bisect(graph, np.random.default_rng(0))


def _metis(graph: Graph, parts: int, single_split: bool) -> dict[str, Call]:
    """Return functions that call METIS directly, none if pymetis is not installed."""
    if find_spec("pymetis") is None:
        return {}
    import pymetis

    # 1. METIS on its CSR arrays
    adjacency = pymetis.CSRAdjacency(graph.indptr, graph.indices)
    recursive = partial(pymetis.part_graph, parts, adjacency, recursive=True)
    if not single_split:
        kway = partial(pymetis.part_graph, parts, adjacency, recursive=False)
        return {"METIS, raw": recursive, "METIS k-way, raw": kway}
    import networkx

    # 2. METIS on a networkx graph, converted as in the paper
    nodes = graph.to_networkx()

    def through_networkx() -> Any:
        numbered = networkx.convert_node_labels_to_integers(nodes)
        lists = [list(numbered[node]) for node in numbered]
        return pymetis.part_graph(parts, adjacency=lists)

    return {"METIS, raw": recursive, "METIS through networkx": through_networkx}
