"""The small 3-D network: data, training, kernels."""
