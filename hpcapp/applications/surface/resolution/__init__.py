"""How fine a mesh is."""
