"""Point clouds as files: what they hold, and their conversion from one format into another."""
