"""Files of splats, one format a file."""
