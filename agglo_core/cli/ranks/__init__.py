"""The commands run and solve on several ranks of MPI."""
