"""One episode of one agent: its rows and what it came to."""
