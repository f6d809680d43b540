"""Read and write further formats with meshlane."""
