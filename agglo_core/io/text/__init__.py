"""Text formats with lists of points and cells, one module per format."""
