"""Beyond the paper: objects from regions that no model made, as levels that refine one another.

Weights-free regions respect outlines but cut objects into pieces, and what stands close into one.
So the surface decides with them: samples of it grow to small pieces (`surfels`), the borders of
pieces are judged by what was learned from scenes with truth (`borders`, `boosted_trees`), pieces
join to a tree, and the best cut through the tree by the learned objectness of its nodes is the
objects (`objects`). Groups that masks of a model give have levels by the same tree (`given`).
"""
