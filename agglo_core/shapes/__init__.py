"""Shape metrics of agglomerates, with their geometry in 2-D and 3-D."""
