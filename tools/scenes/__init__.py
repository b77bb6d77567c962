"""Scenes of scanned objects that fell where physics lets them lie, with their truth."""
