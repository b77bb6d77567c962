"""The command ``gaga``."""
