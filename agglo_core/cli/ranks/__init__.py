"""Commands ``run`` and ``solve`` on several MPI ranks."""
