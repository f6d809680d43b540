"""Formats that are read and written with meshlane."""
