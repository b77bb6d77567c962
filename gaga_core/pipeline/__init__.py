"""Stages over a scene folder, from photos to objects."""
