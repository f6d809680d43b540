"""Build wheels; nothing here is contained in them."""
