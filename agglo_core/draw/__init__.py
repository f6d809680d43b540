"""Pictures of meshes, levels and solutions, box plots, and the report as a web page."""
