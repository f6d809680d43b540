"""The small 2-D network of the bisector ``gnn``: training data, training and compiled evaluation."""
