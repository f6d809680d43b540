"""The small network of space: data, training, kernels."""
