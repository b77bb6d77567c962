"""The tree of merged splats: levels on the disk, nodes in memory.

Level 0 is the opened splats in the order of a Hilbert curve. `WINDOW` neighbours of a level become
a quarter as many of the next one: a splat there stands for one or more that are alike. A node is a
run of `NODE` splats of a level; its children are the four nodes below it. Files in the folder:

    lod.json      format, digest of the model, sizes of the levels
    order.i32     (N,) row of the model at each place of level 0
    level-1.rows  merged splats, chunk after chunk of `CHUNK`; a row is `row_type`
    nodes.npy     (M, 7) float32: box lo, hi and detail of each node, level after level

A tree as streamed SOG: levels of detail that other viewers load piece by piece.
"""

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property
from pathlib import Path
from typing import Annotated

import msgspec
import numpy as np

from gaga_core.arrays import FloatArray, IntArray
from gaga_core.errors import GagaError
from gaga_core.gaussians import Gaussians
from gaga_core.io.arrays_file import read_array
from gaga_core.io.files import explain_os_error, open_file
from gaga_core.io.folder.staging import publish_all, staging_folder
from gaga_core.io.json_file import read_json
from gaga_core.io.splats.packing import COLUMNS, FARTHEST, checked_rows
from gaga_core.io.splats.sog import LOD_META, META, Bound, LodMeta, Node, Range, write_sog_stage
from gaga_core.progress import Progress, Stage, portion

FORMAT = 2  # 1: every four neighbours became one
FILE, ORDER, NODES = "lod.json", "order.i32", "nodes.npy"
FOLDER = "lod"
FAN = 4  # splats that become one on average, and children of a node
WINDOW = 64  # neighbours among which splats are merged: NODE and CHUNK are multiples of it
NODE = 2048  # splats of a node: a line of a data texture
CHUNK = 65536  # splats that are merged, written and read at once
CURE = "Build the level of detail again."

_Count = Annotated[int, msgspec.Meta(ge=1, lt=1 << 31)]


class LodFile(msgspec.Struct, frozen=True):
    """Content of lod.json."""

    format: int
    digest: str
    sizes: list[_Count]  # splats of each level, the opened ones first
    sh: Annotated[int, msgspec.Meta(ge=1, le=25)]  # coefficients
    log_scales: tuple[float, float]  # smallest and largest of all levels


def row_type(n_sh: int) -> np.dtype[np.void]:
    """Layout of a merged splat in a file: raw parameters, and the row that counts most in it."""
    return np.dtype(
        [
            ("means", "<f4", 3),
            ("quats", "<f4", 4),
            ("log_scales", "<f4", 3),
            ("logit", "<f4"),
            ("sh", "<f4", (n_sh, 3)),
            ("row", "<i4"),
        ]
    )


def level_sizes(n: int) -> list[int]:
    """Splats of each level of a tree over ``n``: a quarter of the one below, down to one node."""
    sizes = [n]
    while sizes[-1] > NODE:
        sizes.append(-(-sizes[-1] // FAN))
    return sizes


def first_nodes(sizes: Sequence[int]) -> IntArray:
    """Number of the first node of each level, and of all nodes (L + 1,)."""
    return np.cumsum([0, *(-(-size // NODE) for size in sizes)]).astype(np.int32)


def union_of_children(boxes: FloatArray, firsts: IntArray) -> None:
    """Let the box (M, 6 or more) of every node, in place, hold those of its children."""
    for level in range(len(firsts) - 2):
        first, last = firsts[level], firsts[level + 1]
        parents = last + np.arange(last - first) // FAN
        np.minimum.at(boxes[:, :3], parents, boxes[first:last, :3])
        np.maximum.at(boxes[:, 3:6], parents, boxes[first:last, 3:6])


@dataclass(frozen=True, eq=False)
class LodTree:
    """A tree that is on the disk. Rows are read when asked for; they are never mapped: a mapped
    file that another program truncates would end the process."""

    folder: Path
    digest: str  # of the model that it was built from
    sizes: tuple[int, ...]  # splats of each level
    n_sh: int
    log_scale_range: tuple[float, float]  # smallest, largest
    order: IntArray  # (N,) row of the model at each place of level 0
    boxes: FloatArray  # (M, 6) of each node: lo, hi of what its splats reach, as opened
    details: FloatArray  # (M,) size of what a node cannot show, scene units; 0 at level 0

    def __len__(self) -> int:
        return self.sizes[0]

    @cached_property
    def first_nodes(self) -> IntArray:
        """Number of the first node of each level, and of all nodes (L + 1,)."""
        return first_nodes(self.sizes)

    @cached_property
    def counts(self) -> IntArray:
        """Splats (M,) of each node."""
        full = [np.full(-(-size // NODE), NODE, np.int32) for size in self.sizes]
        for nodes, size in zip(full, self.sizes, strict=True):
            nodes[-1] = size - (len(nodes) - 1) * NODE
        return np.concatenate(full)

    @property
    def n_nodes(self) -> int:
        """Nodes of all levels."""
        return int(self.first_nodes[-1])

    @property
    def file_bytes(self) -> int:
        """Bytes of the files of rows."""
        return 4 * len(self) + sum(self.sizes[1:]) * row_type(self.n_sh).itemsize

    def level_of(self, node: int) -> int:
        """Level of a node."""
        return int(np.searchsorted(self.first_nodes, node, side="right")) - 1

    def span(self, node: int) -> tuple[int, int]:
        """Places of its level that a node holds: first and end."""
        level = self.level_of(node)
        first = (node - int(self.first_nodes[level])) * NODE
        return first, min(first + NODE, self.sizes[level])

    def opened_span(self, node: int) -> tuple[int, int]:
        """Places of level 0 that a node stands for: first and end."""
        level = self.level_of(node)
        first = (node - int(self.first_nodes[level])) * NODE * FAN**level
        return first, min(first + NODE * FAN**level, self.sizes[0])

    def read(self, node: int, opened: Gaussians) -> tuple[Gaussians, IntArray]:
        """Splats (K,) of a node, and the row of the model (K,) that each is or counts most in.

        ``opened``: the model, whose rows are level 0. Raises ``GagaError`` when a file is damaged.
        """
        return self.read_places(self.level_of(node), *self.span(node), opened)

    def read_places(
        self, level: int, first: int, end: int, opened: Gaussians
    ) -> tuple[Gaussians, IntArray]:
        """Splats at the places ``first`` to ``end`` of a level; see `read`."""
        if level == 0:
            rows = self.order[first:end]
            return opened.bare(rows), rows
        return read_rows(self.folder, level, first, end, self.n_sh, len(self))


def level_file(level: int) -> str:
    """Name of the file of a level."""
    return f"level-{level}.rows"


def read_rows(
    folder: Path, level: int, first: int, end: int, n_sh: int, n: int
) -> tuple[Gaussians, IntArray]:
    """Merged splats ``first`` to ``end`` of a level, and their rows of a model of ``n`` splats.

    Splats that cannot be computed with are made transparent. ``GagaError`` when a row is none of
    the model: it would be followed on the GPU.
    """
    path, kind = folder / level_file(level), row_type(n_sh)
    n_bytes = (end - first) * kind.itemsize
    try:
        with open_file(path) as file:
            file.seek(first * kind.itemsize)
            raw = file.read(n_bytes)
    except OSError as error:
        raise GagaError(explain_os_error(error, path)) from error
    if len(raw) != n_bytes:
        raise GagaError(f"{path} is truncated or damaged. {CURE}")
    rows = np.frombuffer(raw, kind)
    *columns, row = (rows[name].copy() for name in kind.names or ())
    good, _ = checked_rows(dict(zip(COLUMNS, columns, strict=True)))
    if row.min(initial=0) < 0 or row.max(initial=0) >= n:
        raise GagaError(f"{path} is damaged: it has rows that are not there. {CURE}")
    m, q, s, o, sh = columns
    for column in columns:
        column[~good] = 0
    o[~good] = -np.inf
    return Gaussians(m, q, s, o, sh), row


def open_lod(folder: Path, digest: str, n: int, n_sh: int) -> LodTree | None:
    """The tree in ``folder`` of the model with this digest, ``n`` splats and ``n_sh`` coefficients.

    None where there is none, or one of another model. Raises ``GagaError`` when it is damaged.
    """
    file = folder / FILE
    if not file.is_file():
        return None
    stored = read_json(file, LodFile, CURE)
    same = stored.format == FORMAT and stored.digest == digest and stored.sh == n_sh
    if not same or stored.sizes != level_sizes(n):
        return None
    try:
        with open_file(folder / ORDER) as stream:
            raw = stream.read(4 * n + 1)
    except OSError as error:
        raise GagaError(explain_os_error(error, folder / ORDER)) from error
    order = np.frombuffer(raw[: len(raw) // 4 * 4], "<i4")
    seen = np.zeros(n, np.bool_)
    if len(raw) == 4 * n and order.min(initial=0) >= 0 and order.max(initial=0) < n:
        seen[order] = True
    if not seen.all():  # each row once
        raise GagaError(f"{folder / ORDER} is truncated or damaged. {CURE}")
    nodes = read_array(folder / NODES, CURE)
    n_nodes = sum(-(-size // NODE) for size in stored.sizes)
    is_table = nodes.shape == (n_nodes, 7) and nodes.dtype == np.float32
    low, high = stored.log_scales
    if not is_table or not -FARTHEST <= low <= high <= FARTHEST:
        raise GagaError(f"{folder / NODES} is damaged. {CURE}")
    nodes = np.clip(np.nan_to_num(nodes), -FARTHEST, FARTHEST)
    for level, size in enumerate(stored.sizes[1:], 1):
        path = folder / level_file(level)
        if not path.is_file() or path.stat().st_size != size * row_type(n_sh).itemsize:
            raise GagaError(f"{path} is truncated or damaged. {CURE}")
    boxes, details = (np.ascontiguousarray(part) for part in (nodes[:, :6], nodes[:, 6]))
    model = folder, digest, tuple(stored.sizes), n_sh, stored.log_scales
    return LodTree(*model, order.astype(np.int32), boxes, details)


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
                first, end = chunk[0][1][level][0], chunk[-1][1][level][1]
                places = level, first, end
                written = _chunk_stage(staging / name, tree, places, opened)
                now = done + end - first
                yield from portion(written, done / total, now / total, STAGE)
                done = now
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


def _chunk_stage(
    path: Path, tree: LodTree, places: tuple[int, int, int], opened: Gaussians
) -> Stage[None]:
    """Write the splats of ``places`` (level, first, end) as a SOG in a folder of their own."""
    yield Progress(STAGE, 0, 1, path.parent.name)
    splats, _ = tree.read_places(*places, opened)
    path.parent.mkdir()
    yield from write_sog_stage(path, splats)


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
