"""One scan against one map: motion model, search, evidence, and the steps that are kept."""
