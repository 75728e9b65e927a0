"""The parts of all tiles, stitched into one mesh."""
