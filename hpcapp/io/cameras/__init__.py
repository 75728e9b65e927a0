"""Camera files of photogrammetry: where photographs were taken from, and where they look."""
