"""Dual graphs with cell geometry: blocks, cuts, objectives, node orderings, sweep rounding."""

from agglo_core.graph.dual import Graph, dual_graph

__all__ = ["Graph", "dual_graph"]
