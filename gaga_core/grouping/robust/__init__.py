"""What the preset ``robust`` adds to the association of the paper."""
