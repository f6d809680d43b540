"""The work: meshes, methods, measurements, and the result store."""
