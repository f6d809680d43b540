"""Arrays and matrices in files: zip archives, MatrixMarket and text, read in bounded memory."""
