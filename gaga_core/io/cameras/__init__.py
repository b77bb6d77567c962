"""Poses of cameras in the files of other programs, read and written."""
