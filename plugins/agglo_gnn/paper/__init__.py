"""The paper's network in torch: bisector, data, training."""
