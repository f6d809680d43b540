"""Compute cell geometry from faces: measures, centroids, inertia, diameters, boundary loops."""
