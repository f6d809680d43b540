"""Base of the laws: case, law, verdict, the component under test."""
