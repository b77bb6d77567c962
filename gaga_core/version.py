"""The version of the program, which files and requests of ours name."""

__version__ = "0.1.0"
