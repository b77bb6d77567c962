"""Captures as people take them, generated, each with what the placement must do with it."""
