"""The small 3-D network of the bisector ``gnn``: training data, training and compiled evaluation."""
