"""mavnav: offline SLAM, maps and map quality from recorded 2D laser logs."""

__version__ = "0.1.0"
