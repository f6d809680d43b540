"""Error estimators for solutions of PolyDG."""
