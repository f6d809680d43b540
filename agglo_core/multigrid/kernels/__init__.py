"""Kernels of multigrid: sparse products, sweeps, patches, aggregates."""
