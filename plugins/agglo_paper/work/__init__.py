"""Computations behind the results: meshes, methods, measurements, and a store for results."""
