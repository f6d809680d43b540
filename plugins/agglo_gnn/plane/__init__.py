"""The small 2-D network: data, training, kernels."""
