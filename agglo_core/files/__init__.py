"""Files in bounded memory: zip archives, MatrixMarket and text with arrays and matrices, regular files only."""
