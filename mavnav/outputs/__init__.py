"""Outputs: the files of a run, each by one writer, and the directory that holds them."""
