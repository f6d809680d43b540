"""Pictures of 3-D meshes: surfaces, visibility, light, interactive views."""
