"""References for the comparison of a run, besides its log: a true trajectory, a true map, relations."""
