"""What a flow leaves, seen from above: thickness, depth and velocity as rasters, outlines and pictures."""
