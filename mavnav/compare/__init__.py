"""The pipeline of ``mavnav compare``: logs x settings -> replays in processes of their own -> one comparison."""
