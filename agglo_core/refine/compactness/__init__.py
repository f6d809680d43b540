"""The refiner compactness: parts of small moments of inertia with short interfaces."""
