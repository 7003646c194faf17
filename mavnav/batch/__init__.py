"""The pipeline of ``mavnav batch``: many logs with many settings, each run apart, one verdict."""
