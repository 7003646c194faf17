"""Containers: which format a file has, and a reader for each."""
