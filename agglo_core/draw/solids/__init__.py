"""Pictures of solids: surfaces, visibility, light, scenes."""
