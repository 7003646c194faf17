"""Passes that match lost scans once more."""
