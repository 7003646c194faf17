"""Files of a run directory that other programs read: maps, trajectories, tables and recordings."""
