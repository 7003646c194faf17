"""References: what is known besides the log, to compare a run with: a truth, a true map, relations."""
