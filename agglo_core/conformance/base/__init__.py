"""Base classes of the suite: case, law, verdict and the component under test."""
