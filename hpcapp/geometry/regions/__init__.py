"""Parts of space that a user asks for, and meshes cut along their borders."""
