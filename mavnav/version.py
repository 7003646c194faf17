"""The version of mavnav."""

__version__ = "0.2.0"
