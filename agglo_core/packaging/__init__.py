"""Build of wheels with compiled kernels (this folder is not part of them)."""
