"""Corrections by hand: a mask moved to another group, a group split by its masks."""
