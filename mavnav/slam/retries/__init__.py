"""Passes that track a log again with one thing changed, and keep the better track."""
