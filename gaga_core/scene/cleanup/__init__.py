"""Cleaning of objects: floaters out, hidden left-overs in."""
