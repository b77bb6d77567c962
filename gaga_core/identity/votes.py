"""Identity in closed form: the label that the views' masks vote for, per Gaussian.

The vote itself lives with the association, which needs it for its reassign passes; identity
encodings start from the same result.
"""

from gaga_core.grouping.votes import Votes, associated_labels, vote_labels

__all__ = ["Votes", "associated_labels", "vote_labels"]
