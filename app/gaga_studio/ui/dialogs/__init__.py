"""Dialogs: files, export, masks, preferences, shortcuts."""
