"""Processing of one image: its pyramid, interpolation, and the selection of pixels for tracking."""
