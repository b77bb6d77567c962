"""Labelled data of new views: where they stand, what stands where, the labels, and the formats."""
