"""Beyond the paper: objects from regions that no model made, as levels that refine one another.

Weights-free regions respect outlines but cut objects into pieces, and what stands close into one.
So the surface decides with them: samples of it (`surfels`) grow to small pieces (`pieces`), large
planes are found (`sheets`), and borders between pieces are judged by two witnesses, the share of
views that show both sides in one region, and the shape of the surface there (`borders`). Pieces
join in the order of the evidence (`linkage`), which gives levels from fine pieces to whole objects
(`objects`); thin objects on a surface stay apart from it (`enclosed`), what turns out to be two
objects is divided (`divided`), a surface is one on both sides of what lies across it (`spanned`),
and what surrounds the scene becomes one group (`background`).
"""
