"""The format .npz, which holds a mesh and its hierarchy without loss."""
