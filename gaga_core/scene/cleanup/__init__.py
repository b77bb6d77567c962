"""Cleaning of objects: floaters out, hidden rests in."""
