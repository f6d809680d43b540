"""Simplify meshes: merge straight edge chains and flat face patches into single faces."""
