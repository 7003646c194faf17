"""Several sessions in one frame: which of them saw the same walls, one pose graph over all, and one map."""
