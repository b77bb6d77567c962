"""Metrics of the paper (supplement, Algorithm 1)."""
