"""gaga-studio: the window."""
