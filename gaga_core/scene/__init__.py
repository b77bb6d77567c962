"""The scene being edited: columns, edits, history, selection, export."""
