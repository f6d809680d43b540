"""Refiners that move cells between parts, and the fixer of connectivity, with their kernels."""
