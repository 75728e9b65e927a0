"""Point clouds in their canonical order: blocks in memory or in a folder, outliers, spacing."""
