"""Asking for objects: by words alone, by an index of pictures, by a detector in one view."""
