"""Construct the levels: recursive bisection, k-way partition, lines of cells, and post-processing."""
