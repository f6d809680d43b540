"""Call a component of any kind with the arguments of a test case, as its protocol specifies."""

from __future__ import annotations

from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any

import numpy as np

from agglo_core.arrays import UInt64
from agglo_core.conformance.base.case import Case
from agglo_core.conformance.base.verdict import Broken
from agglo_core.errors import AggloError
from agglo_core.graph import Graph
from agglo_core.mesh import Mesh
from agglo_core.problems import require_accepted
from agglo_core.protocols import Target
from agglo_core.registry import KINDS


def ask(kind: str, tool: Any, case: Case) -> Any:
    """Call a component with the arguments of a test case, and return the result unchecked.

    Exceptions of the component propagate. Problems are passed only if ``accepts`` lists their kind, as in
    ``agglo solve``.
    """
    given = case.given
    match kind:
        case "sample":  # building the sample was the call under test
            return tool
        case "problem":
            return tool.example(*given)
        case "bisector":
            return _sides(tool, *given)
        case "format":
            return _read_back(tool, *given)
        case "constraint":
            return _masks(tool, *given)
        case "smoother":
            return tool.setup(given[0])(*given[1:])
        case "coarse_solver":
            return tool.solver_for(given[0])(*given[1:])
        case "solver" | "discretisation":
            require_accepted(tool, given[0])
    return getattr(tool, KINDS[kind].methods[0])(*given)


def for_target(tool: Any, target: Target) -> Any:
    """Call ``for_target`` of a bisector, and require that the result is a bisector.

    Raises
    ------
    Broken
        If the returned object is not a bisector.
    AggloError
        If the component refuses the target.
    """
    bisector = tool.for_target(target)
    bisects = any(callable(getattr(bisector, name, None)) for name in ("bisect_level", "bisect"))
    if not bisects or isinstance(bisector, type):
        raise Broken(
            f"for {target} it returned a {type(bisector).__name__} ({bisector!r:.40}), expected an object "
            "with bisect_level or bisect"
        )
    return bisector


def _sides(tool: Any, graph: Graph, seeds: UInt64, target: Target | None = None) -> Any:
    """Return the side per node, or the labels of a direct k-way partition.

    A direct partition is requested if a target is given or if the component has no ``bisect`` method.
    """
    if target is None and hasattr(tool, "bisect_level"):
        return tool.bisect_level(graph, seeds)
    # Without bisect_level, call the component once per block and join the answers.
    blocks = [graph[b] for b in range(graph.n_blocks)] if graph.n_blocks > 1 else [graph]
    if target is None and hasattr(tool, "bisect"):
        answers = [
            tool.bisect(block, np.random.default_rng(int(seed)))
            for block, seed in zip(blocks, seeds, strict=True)
        ]
    else:
        answers = [
            tool.partition(block, target or Target(parts=min(2, block.n)), int(seed))
            for block, seed in zip(blocks, seeds, strict=True)
        ]
    if len(answers) == 1:
        return answers[0]
    try:
        return np.concatenate([np.atleast_1d(a) for a in answers])
    except ValueError:  # of different dimensions, or ragged: the laws report the form
        return answers


def _read_back(tool: Any, mesh: Mesh, suffix: str) -> Any:
    """Write a mesh to a temporary file and read it back.

    Only ``write`` may raise an AggloError: the component must read its own files.
    """
    with TemporaryDirectory() as folder:
        path = Path(folder) / f"mesh{suffix}"
        tool.write(path, mesh)
        try:
            return tool.read(path)
        except AggloError as error:
            raise Broken(
                f"on {mesh.name}: it wrote {path.name} and then refused to read it: {error}"
            ) from None


def _masks(tool: Any, mesh: Mesh, labels: Any) -> dict[str, Any]:
    """Call the methods that a constraint has, and return their boolean masks by method name."""
    tool, graph = tool.for_mesh(mesh) if hasattr(tool, "for_mesh") else tool, mesh.graph
    arguments = {"forbidden": (graph,), "admissible": (graph, labels), "incomplete": (graph, labels)}
    return {
        method: np.asarray(getattr(tool, method)(*values))
        for method, values in arguments.items()
        if callable(getattr(tool, method, None))
    }
