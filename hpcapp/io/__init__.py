"""Point clouds and meshes in files, by suffix."""
