"""Weights of models: which are known, where they lie, how they get here."""
