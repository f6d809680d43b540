"""Meshes: points, faces and the cells beside them; how they are built and checked, and their geometry."""

from agglo_core.mesh.polytopal import Loops, Mesh, box_centre, check_labels

__all__ = ["Loops", "Mesh", "box_centre", "check_labels"]
