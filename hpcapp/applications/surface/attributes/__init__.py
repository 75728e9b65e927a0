"""What the mesh's vertices take over from the points: which columns, and how they get there."""
