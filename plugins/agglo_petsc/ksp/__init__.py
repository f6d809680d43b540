"""Multigrid preconditioning of PETSc's Krylov solvers (KSP): set-up, options, report, checked solve."""
