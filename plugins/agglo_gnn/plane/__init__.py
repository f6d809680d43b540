"""The small network of the plane: data, training, kernels."""
