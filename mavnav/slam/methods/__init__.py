"""The two methods, what the tracker needs of them, and when a match is accepted."""
