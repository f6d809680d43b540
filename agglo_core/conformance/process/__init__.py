"""Checks of a component in a child process or after a fresh import."""
