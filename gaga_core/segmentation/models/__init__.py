"""Weights of models: which are known, where they are stored, how they are downloaded."""
