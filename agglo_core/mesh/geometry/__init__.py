"""Geometry of cells from their faces: measures, centroids, inertia, diameters, boundary loops."""
