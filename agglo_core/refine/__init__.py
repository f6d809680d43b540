"""Refiners that move cells between parts, the connectivity fixer, and their kernels."""
