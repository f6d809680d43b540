"""Dual graphs with cell geometry, and their blocks, orders, cuts and sweeps."""

from agglo_core.graph.dual import Graph, dual_graph

__all__ = ["Graph", "dual_graph"]
