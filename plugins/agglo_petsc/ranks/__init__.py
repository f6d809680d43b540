"""What is divided among ranks: rows, patches, and sweeps through them."""
