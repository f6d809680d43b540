"""Compiled multigrid kernels: sparse products, sweeps, patches, aggregates."""
