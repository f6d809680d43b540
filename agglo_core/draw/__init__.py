"""Pictures of meshes and levels, box plots, and the report as a web page."""
