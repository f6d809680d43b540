"""Metrics of the shape of agglomerates, with the geometry they need in the plane and in space."""
