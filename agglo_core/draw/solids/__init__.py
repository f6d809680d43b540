"""Pictures of solids: surfaces, sight, light, scenes."""
