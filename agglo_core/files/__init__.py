"""Read files in bounded memory: regular files, array archives, MatrixMarket, numbers in text."""
