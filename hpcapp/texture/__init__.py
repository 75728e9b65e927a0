"""The look of a fine surface on a light mesh: an atlas of its charts, and the pictures in it."""
