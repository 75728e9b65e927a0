"""Points and meshes as arrays, and what is true of them wherever they come from."""
