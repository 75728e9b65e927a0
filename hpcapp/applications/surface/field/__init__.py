"""From points to a field: moments, the pyramid of quadrics, their weights, and the far field."""
