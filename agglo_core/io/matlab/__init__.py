"""MATLAB's .mat files, and what MRST, lymph and others keep in them."""
