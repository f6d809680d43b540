"""Solutions of PDEs across ranks: VTK files, error norms."""
