"""Compiled kernels of multigrid: sparse products, sweeps, patches, aggregates."""
