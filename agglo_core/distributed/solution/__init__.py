"""Solutions across ranks: files of pieces, error norms."""
