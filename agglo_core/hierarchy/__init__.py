"""Hierarchies of coarse meshes: the tree of splits, its levels, and cuts with parts of several levels."""

from agglo_core.hierarchy.cuts import Change, Cut
from agglo_core.hierarchy.forest import Forest
from agglo_core.hierarchy.levels import Hierarchy
from agglo_core.hierarchy.tree import Tree, by_first_cell

__all__ = ["Change", "Cut", "Forest", "Hierarchy", "Tree", "by_first_cell"]
