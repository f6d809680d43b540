"""K-way partitions by the paper's network, in torch operations on the CPU or a GPU."""
