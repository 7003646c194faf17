"""The pipeline of ``mavnav compare``: a batch of logs x settings -> one comparison."""
