"""Heights of a terrain for maps: a GeoTIFF and contours."""
