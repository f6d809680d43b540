"""Dual graphs with cell geometry; blocks, orders, cuts and sweeps on them."""

from agglo_core.graph.dual import Graph, dual_graph

__all__ = ["Graph", "dual_graph"]
