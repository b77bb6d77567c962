"""Tools: what a drag or click in the viewport does, one a file."""
