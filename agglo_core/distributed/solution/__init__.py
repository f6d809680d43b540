"""Solutions across ranks: piece files, error norms."""
