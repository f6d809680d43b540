"""Measure how the shapes of agglomerates affect solvers, over partitions from excellent to bad."""
