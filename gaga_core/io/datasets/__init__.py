"""Benchmark data sets as they lie on disk: one reader a layout, one description for all."""
