"""Read and write VTK files: .vtu, .pvtu, .vtp, VTKHDF and legacy .vtk."""
