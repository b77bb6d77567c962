"""A tree as streamed SOG: levels of detail that other viewers load piece by piece."""

from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path

import msgspec
import numpy as np

from gaga_core.arrays import FloatArray
from gaga_core.gaussians import Gaussians
from gaga_core.io.folder.staging import publish_all, staging_folder
from gaga_core.io.splats.sog import LOD_META, META, Bound, LodMeta, Node, Range, write_sog_stage
from gaga_core.progress import Progress, Stage
from gaga_core.scene.lod.tree import FAN, LodTree

STAGE = "Write streamed SOG"
_MOST_LEVELS = 5
_LEAF_LEVEL = 2  # its nodes are the leaves: 32,768 splats of level 0 each
_CHUNK_LEAVES = 16  # of level 0, in a chunk: some 500,000 splats


@dataclass(frozen=True)
class _Leaf:
    """A leaf, and its splats of each level: first and end."""

    node: int
    spans: tuple[tuple[int, int], ...]


def write_streamed_sog_stage(folder: Path, tree: LodTree, opened: Gaussians) -> Stage[Path]:
    """Write the levels of ``tree`` into ``folder``, whole or not at all; returns the lod-meta.json.

    ``opened``: the model. Positions, sizes and colors are rounded as in every SOG. Raises
    ``GagaError`` when the place cannot be written.
    """
    folder = Path(folder)
    n_levels = min(len(tree.sizes), _MOST_LEVELS)
    leaves = _leaves(tree, n_levels)
    filenames: list[str] = []
    ranges: dict[tuple[int, int], Range] = {}  # by leaf and level
    total, done = sum(tree.sizes[:n_levels]), 0
    with staging_folder(folder) as staging:
        for level in range(n_levels):
            for k, chunk in enumerate(_chunks(leaves, level)):
                name = f"{level}_{k}/{META}"
                offset = 0
                for leaf in chunk:
                    first, end = leaf.spans[level]
                    ranges[leaf.node, level] = Range(len(filenames), offset, end - first)
                    offset += end - first
                filenames.append(name)
                yield Progress(STAGE, done, total, name)
                first, end = chunk[0].spans[level][0], chunk[-1].spans[level][1]
                splats, _ = tree.read_places(level, first, end, opened)
                (staging / name).parent.mkdir()
                yield from write_sog_stage(staging / name, splats)
                done += len(splats)
        meta = LodMeta(
            lodLevels=n_levels,
            filenames=filenames,
            tree=_boxes(tree, leaves, ranges, n_levels),
            asset={"generator": "gaga-studio"},
            count=total,
            counts=list(tree.sizes[:n_levels]),
        )
        # Defaults are left out of nodes, but a reader wants the version.
        (staging / LOD_META).write_bytes(_with_version(meta))
        names = sorted({name.split("/")[0] for name in filenames})
        publish_all(staging, [*names, LOD_META], folder)
    return folder / LOD_META


def _with_version(meta: LodMeta) -> bytes:
    content = msgspec.json.decode(msgspec.json.encode(meta), type=dict[str, object])
    return msgspec.json.encode({"version": 1, **content})


def _leaves(tree: LodTree, n_levels: int) -> list[_Leaf]:
    """Nodes of a level as leaves, with their splats of all levels."""
    level = min(_LEAF_LEVEL, len(tree.sizes) - 1)
    found = []
    for node in range(int(tree.first_nodes[level]), int(tree.first_nodes[level + 1])):
        first, end = tree.opened_span(node)
        spans = tuple((first // FAN**k, -(-end // FAN**k)) for k in range(n_levels))
        found.append(_Leaf(node, spans))
    return found


def _chunks(leaves: list[_Leaf], level: int) -> Iterator[list[_Leaf]]:
    n = _CHUNK_LEAVES * FAN**level
    for start in range(0, len(leaves), n):
        yield leaves[start : start + n]


def _boxes(
    tree: LodTree, leaves: list[_Leaf], ranges: dict[tuple[int, int], Range], n_levels: int
) -> Node:
    """The tree of boxes over the leaves, `FAN` to one."""
    nodes = [
        Node(
            _bound(tree.boxes[leaf.node]),
            lods={str(level): ranges[leaf.node, level] for level in range(n_levels)},
        )
        for leaf in leaves
    ]
    while len(nodes) > 1:
        groups = [nodes[at : at + FAN] for at in range(0, len(nodes), FAN)]
        nodes = [Node(_around(group), children=group) for group in groups]
    return nodes[0]


def _bound(box: FloatArray) -> Bound:
    low, high = box[:3].tolist(), box[3:].tolist()
    return Bound((low[0], low[1], low[2]), (high[0], high[1], high[2]))


def _around(nodes: list[Node]) -> Bound:
    low = np.min([node.bound.min for node in nodes], axis=0).tolist()
    high = np.max([node.bound.max for node in nodes], axis=0).tolist()
    return Bound((low[0], low[1], low[2]), (high[0], high[1], high[2]))
