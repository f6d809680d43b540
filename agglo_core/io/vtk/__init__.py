"""Files of VTK: .vtu, .pvtu, .vtp, VTKHDF and legacy .vtk."""
