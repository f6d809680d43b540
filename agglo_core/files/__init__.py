"""Read files in bounded memory: regular files, array archives, MatrixMarket files, numbers in text."""
