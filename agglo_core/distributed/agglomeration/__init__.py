"""Agglomeration across ranks: domains, levels, targets, constraints."""
