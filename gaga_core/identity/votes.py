"""Identity in closed form: the label that the views' masks vote for, per Gaussian.

The vote itself lives with the association, which labels every Gaussian by it; identity
encodings start from the same result.
"""

from gaga_core.grouping.votes import Votes, associated_labels, vote_labels

__all__ = ["Votes", "associated_labels", "vote_labels"]
