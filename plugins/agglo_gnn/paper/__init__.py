"""The network of the paper in torch: bisector, training data and training."""
