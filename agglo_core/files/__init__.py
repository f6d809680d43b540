"""Files read in bounded memory: regular files, archives of arrays, MatrixMarket, numbers in text."""
