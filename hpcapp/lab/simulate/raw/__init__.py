"""Raw scans of scenes: what a scanner delivers, with the true surface and its trajectory."""
