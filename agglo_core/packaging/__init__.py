"""Build wheels (this folder is not part of them)."""
