"""Files of meshes and hierarchies across ranks."""
