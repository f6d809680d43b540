"""The inputs that laws are tried on, and what is asked of components."""
