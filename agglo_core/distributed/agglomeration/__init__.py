"""Agglomeration across ranks: domains, levels, goals, rules."""
