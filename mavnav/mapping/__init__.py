"""The map: the occupancy grid, the local line map beside it, and the tiled arrays that both grow in."""
