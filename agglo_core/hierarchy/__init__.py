"""The tree of splits, and the coarse levels cut from it."""

from agglo_core.hierarchy.levels import Hierarchy
from agglo_core.hierarchy.tree import Tree, by_first_cell

__all__ = ["Hierarchy", "Tree", "by_first_cell"]
