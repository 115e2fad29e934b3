"""The table of a sweep, its charts, what its variants look like, its page."""
