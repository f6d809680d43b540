"""Solutions across ranks: pieces for files, norms of errors."""
