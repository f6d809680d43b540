"""What the shapes of agglomerates do to solvers: partitions from excellent to bad, iterations, errors."""
