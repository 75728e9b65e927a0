"""From the points to the mesh's vertices: colours, labels and other numbers."""
