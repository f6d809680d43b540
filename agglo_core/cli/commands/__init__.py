"""The commands of agglo, one module each."""
