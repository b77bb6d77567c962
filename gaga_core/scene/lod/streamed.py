"""A tree as streamed SOG: levels of detail that other viewers load piece by piece."""

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


def write_streamed_sog_stage(folder: Path, tree: LodTree, opened: Gaussians) -> Stage[Path]:
    """Write the levels of ``tree`` into ``folder``, whole or not at all; returns the lod-meta.json.

    ``opened``: the model. Positions, sizes and colors are rounded as in every SOG. Raises
    ``GagaError`` when the place cannot be written.
    """
    folder = Path(folder)
    n_levels = min(len(tree.sizes), _MOST_LEVELS)
    # Leaves: nodes of a level, and the splats of each level that they stand for, first and end.
    leaf_level = min(_LEAF_LEVEL, len(tree.sizes) - 1)
    leaves = []
    for node in range(int(tree.first_nodes[leaf_level]), int(tree.first_nodes[leaf_level + 1])):
        first, end = tree.opened_span(node)
        spans = [(first // FAN**k, -(-end // FAN**k)) for k in range(n_levels)]
        leaves.append((node, spans))
    filenames: list[str] = []
    ranges: dict[tuple[int, int], Range] = {}  # by leaf and level
    total, done = sum(tree.sizes[:n_levels]), 0
    with staging_folder(folder) as staging:
        for level in range(n_levels):
            n_leaves = _CHUNK_LEAVES * FAN**level
            for k, start in enumerate(range(0, len(leaves), n_leaves)):
                chunk = leaves[start : start + n_leaves]
                name = f"{level}_{k}/{META}"
                offset = 0
                for node, spans in chunk:
                    first, end = spans[level]
                    ranges[node, level] = Range(len(filenames), offset, end - first)
                    offset += end - first
                filenames.append(name)
                yield Progress(STAGE, done, total, name)
                first, end = chunk[0][1][level][0], chunk[-1][1][level][1]
                splats, _ = tree.read_places(level, first, end, opened)
                (staging / name).parent.mkdir()
                yield from write_sog_stage(staging / name, splats)
                done += len(splats)
        meta = LodMeta(
            lodLevels=n_levels,
            filenames=filenames,
            tree=_boxes(tree, ranges, n_levels),
            asset={"generator": "gaga-studio"},
            count=total,
            counts=list(tree.sizes[:n_levels]),
        )
        # Defaults are left out of nodes, but a reader wants the version.
        content = msgspec.json.decode(msgspec.json.encode(meta), type=dict[str, object])
        (staging / LOD_META).write_bytes(msgspec.json.encode({"version": 1, **content}))
        names = sorted({name.split("/")[0] for name in filenames})
        publish_all(staging, [*names, LOD_META], folder)
    return folder / LOD_META


def _boxes(tree: LodTree, ranges: dict[tuple[int, int], Range], n_levels: int) -> Node:
    """The tree of boxes over the leaves, `FAN` to one; ``ranges`` by leaf and level, in order."""
    nodes = []
    for leaf in dict.fromkeys(leaf for leaf, _ in ranges):
        lods = {str(level): ranges[leaf, level] for level in range(n_levels)}
        nodes.append(Node(_bound(tree.boxes[leaf, :3], tree.boxes[leaf, 3:]), lods=lods))
    while len(nodes) > 1:
        groups = [nodes[at : at + FAN] for at in range(0, len(nodes), FAN)]
        nodes = [Node(_around(group), children=group) for group in groups]
    return nodes[0]


def _bound(low: FloatArray, high: FloatArray) -> Bound:
    a, b, c = low.tolist()
    d, e, f = high.tolist()
    return Bound((a, b, c), (d, e, f))


def _around(nodes: list[Node]) -> Bound:
    low = np.min([node.bound.min for node in nodes], axis=0)
    return _bound(low, np.max([node.bound.max for node in nodes], axis=0))
