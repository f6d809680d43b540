"""Checks of a component in another process."""
