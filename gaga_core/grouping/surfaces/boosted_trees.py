"""What was learned about borders and objects: ensembles of regression trees in ``objects.npz``.

They are made from scenes with truth by `tools.learn_objects`.
"""

from collections.abc import Mapping
from dataclasses import dataclass, fields
from functools import cache
from typing import NamedTuple

import numpy as np

from gaga_core.arrays import AnyArray, DoubleArray, IntArray
from gaga_core.grouping.surfaces.surfels_kernels import sum_of_trees
from gaga_core.io.arrays_file import Column, damage, read_columns
from gaga_core.io.files import assets

FILE = "objects.npz"


@dataclass(frozen=True, eq=False)
class BoostedTrees:
    """A sum of regression trees over features, as gradient boosting makes it (Friedman, Annals of
    Statistics 2001). Nodes follow one another, children after their parent."""

    roots: IntArray  # (T,) first node of each tree
    feature: IntArray  # (n,) that an inner node asks
    threshold: DoubleArray  # (n,) up to which the way goes to the next node, beyond it to `right`
    right: IntArray  # (n,) node; 0 = a leaf
    value: DoubleArray  # (n,) of a leaf
    base: DoubleArray  # (1,) added to all

    def __call__(self, features: DoubleArray) -> DoubleArray:
        """The sums (R,) of rows of features (R, F). Raises ``ValueError`` when F is too small."""
        if self.feature.max(initial=0) >= features.shape[1]:
            raise ValueError(f"features: {features.shape[1]} are too few for these trees")
        out = np.empty(len(features))
        columns = (self.roots, self.feature, self.threshold, self.right, self.value)
        sum_of_trees(np.ascontiguousarray(features), *columns, out)
        result: DoubleArray = out + self.base[0]
        return result

    def arrays(self, name: str) -> dict[str, AnyArray]:
        """What is stored, in half of the bytes."""
        stored = {f"{name}_{key.name}": getattr(self, key.name) for key in fields(self)}
        return {
            key: a.astype(np.float32 if a.dtype.kind == "f" else np.int32)
            for key, a in stored.items()
        }

    @staticmethod
    def of(arrays: Mapping[str, AnyArray], name: str) -> "BoostedTrees":
        """From arrays as `arrays` gives them; ``ValueError`` unless each way ends in a leaf."""
        trees = BoostedTrees(*(arrays[f"{name}_{key.name}"] for key in fields(BoostedTrees)))
        inner = trees.right > 0
        forward = trees.right[inner] > np.flatnonzero(inner) + 1
        if not forward.all():
            raise ValueError(f"{name}: a way through a tree has no end")
        return trees


class Learned(NamedTuple):
    """The four ensembles."""

    pieces: BoostedTrees  # log odds that two small pieces are one object
    borders: BoostedTrees  # the same of what has grown from them
    objects: BoostedTrees  # IoU of a node of the tree with the true object that is most alike
    alone: BoostedTrees  # the same in a file of objects without surroundings


def columns_of(name: str) -> dict[str, Column]:
    """What the arrays of an ensemble must be."""
    nodes, trees = f"{name} nodes", f"{name} trees"
    number = Column(np.float64, (nodes,))
    return {
        f"{name}_roots": Column(np.int32, (trees,), low=0, below=nodes),
        f"{name}_feature": Column(np.int32, (nodes,), low=0),
        f"{name}_threshold": number,
        f"{name}_right": Column(np.int32, (nodes,), low=0, below=nodes),
        f"{name}_value": number,
        f"{name}_base": Column(np.float64, (1,)),
    }


@cache
def learned() -> Learned:
    """The ensembles that the program carries, read once. Raises ``GagaError`` when the file is
    damaged."""
    wanted = {key: column for name in Learned._fields for key, column in columns_of(name).items()}
    path, cure = assets() / FILE, "Install the program again."
    arrays = read_columns(path, cure, wanted)
    with damage(path, cure):
        return Learned(*(BoostedTrees.of(arrays, name) for name in Learned._fields))
