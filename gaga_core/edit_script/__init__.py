"""Edits as JSON that a person or a program can write: what ``gaga edit`` runs."""
