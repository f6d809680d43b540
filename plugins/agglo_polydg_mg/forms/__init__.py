"""Bilinear forms, loads, penalties and norms."""
