"""Read and write OpenFOAM cases, whole or decomposed into processors."""
