"""Test inputs for the laws: meshes, graphs, systems and cases."""
