"""Compactness refiner: parts with small moments of inertia and short interfaces."""
