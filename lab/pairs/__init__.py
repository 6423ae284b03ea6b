"""Two effects at once on drawn rigs, and structural faults of frames and of their description."""
