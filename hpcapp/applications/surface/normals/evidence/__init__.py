"""What is measured of a scan, the hypotheses that explain it, and how probable each is."""
