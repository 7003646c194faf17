"""Passes that correct the finished track and draw its map again."""
