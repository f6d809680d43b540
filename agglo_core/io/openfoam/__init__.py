"""Cases of OpenFOAM, whole or in pieces of processors."""
