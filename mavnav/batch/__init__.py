"""The pipeline of ``mavnav batch``: many logs with many settings, each run in its own process, and one exit code."""
