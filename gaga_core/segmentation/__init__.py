"""2D masks of single pictures: segmenters of many kinds behind one protocol (section 4.1)."""
