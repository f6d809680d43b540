"""Dual graphs with cell geometry; blocks, orders, cuts and sweeps on them."""

from agglo_core.graph.dual import Graph

__all__ = ["Graph"]
