"""The machine: the window of the operating system, paths, the log. Knows nothing of scenes."""
