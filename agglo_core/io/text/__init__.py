"""Formats that list points and cells as text, one file each."""
