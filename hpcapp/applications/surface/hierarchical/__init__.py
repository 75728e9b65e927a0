"""The default method: hierarchical Hermite quadrics, tile by tile."""
