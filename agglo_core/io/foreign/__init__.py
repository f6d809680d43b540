"""Read and write further mesh formats through the Python package meshlane."""
