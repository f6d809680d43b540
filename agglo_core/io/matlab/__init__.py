"""Read and write MATLAB's .mat files in the layouts of MRST, lymph and other programs."""
