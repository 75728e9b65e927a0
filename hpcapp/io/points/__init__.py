"""Point clouds in files: a module per format, and what all of them share."""
