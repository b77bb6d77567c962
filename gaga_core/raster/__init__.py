"""Rasterizers of Gaussians behind one protocol."""
