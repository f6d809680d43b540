"""Inputs for the laws: meshes, graphs, linear systems and test cases."""
