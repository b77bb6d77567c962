"""The preset ``robust``: additions to the association of the paper."""
