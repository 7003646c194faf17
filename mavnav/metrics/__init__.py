"""Metrics: pure functions from maps and trajectories to numbers."""
