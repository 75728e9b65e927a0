"""Point clouds in files of NumPy."""
