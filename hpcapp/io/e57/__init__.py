"""E57: scans with their poses, read and written by libE57 (pye57)."""
