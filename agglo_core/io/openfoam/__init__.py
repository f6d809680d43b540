"""Read and write the meshes of OpenFOAM cases, whole or decomposed among processors."""
