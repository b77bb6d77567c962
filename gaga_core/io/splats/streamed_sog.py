"""Streamed SOG: SOG chunks at several levels of detail, and a lod-meta.json that lists them.

Version 1, as PlayCanvas documents it: the leaves of a tree of boxes name, for each level of detail
they have, a range of splats of a chunk; level 0 is the finest. A chunk is a SOG in a folder of its
own. Specification: developer.playcanvas.com/user-manual/gaussian-splatting/formats/streamed-sog.
"""

from collections.abc import Iterator
from dataclasses import dataclass, replace
from pathlib import Path, PurePosixPath
from typing import Annotated

import msgspec
import numpy as np

from gaga_core.errors import GagaError
from gaga_core.gaussians import Gaussians
from gaga_core.io.json_file import read_foreign_json
from gaga_core.io.splats.packing import room_for
from gaga_core.io.splats.sog import META, read_sog_stage
from gaga_core.progress import Progress, Stage

LOD_META = "lod-meta.json"
_MOST_META = 1 << 28  # bytes
_MOST_DEPTH = 64  # of the tree
_Index = Annotated[int, msgspec.Meta(ge=0, lt=1 << 31)]
Vector = tuple[float, float, float]


class Bound(msgspec.Struct, frozen=True):
    """A box, scene units."""

    min: Vector
    max: Vector


class Range(msgspec.Struct, frozen=True):
    """Splats of a chunk."""

    file: _Index  # place in `LodMeta.filenames`
    offset: _Index
    count: _Index


class Node(msgspec.Struct, frozen=True, omit_defaults=True):
    """A box of the tree: divided, or with splats at some levels of detail."""

    bound: Bound
    children: "list[Node]" = []
    lods: dict[str, Range] = {}


class LodMeta(msgspec.Struct, frozen=True, omit_defaults=True):
    """Content of lod-meta.json."""

    lodLevels: _Index  # noqa: N815  as the format names it
    filenames: list[str]
    tree: Node
    version: int = 1
    asset: dict[str, str] = {}
    count: _Index = 0  # of all levels
    counts: list[_Index] = []  # of each level
    environment: str = ""


def is_streamed_sog(path: Path) -> bool:
    """Whether ``path`` is a lod-meta.json, by its name."""
    return path.name == LOD_META and path.is_file()


@dataclass(frozen=True)
class _Part:
    """Rows of a chunk that are read."""

    start: int
    stop: int


def read_streamed_sog_stage(path: Path) -> Stage[Gaussians]:
    """Read the finest level of every leaf, and the environment, with progress.

    ``GagaError`` with one sentence when something is missing or damaged.
    """
    path = Path(path)
    meta = read_foreign_json(path, LodMeta, most_bytes=_MOST_META)
    if meta.version != 1:
        raise GagaError(f"{path} is version {meta.version} of streamed SOG; only 1 can be read.")
    wanted: dict[int, list[_Part]] = {}
    for leaf in _leaves(meta.tree, path, 0):
        if not leaf.lods:
            continue
        finest = leaf.lods[min(leaf.lods, key=_level)]
        if finest.file >= len(meta.filenames):
            raise GagaError(f"{path} names chunk {finest.file}, which it does not list.")
        part = _Part(finest.offset, finest.offset + finest.count)
        wanted.setdefault(finest.file, []).append(part)
    pieces: list[Gaussians] = []
    names = [(meta.filenames[file], parts) for file, parts in sorted(wanted.items())]
    if meta.environment:
        names.append((meta.environment, []))
    if not names:
        raise GagaError(f"{path} names no splats. Export it again.")
    for done, (name, parts) in enumerate(names):
        yield Progress("Read splats", done, len(names), name)
        chunk = yield from read_sog_stage(chunk_path(path, name))
        n_asked = sum(part.stop - part.start for part in parts)  # at one level none is asked twice
        if n_asked > len(chunk) or any(part.stop > len(chunk) for part in parts):
            raise GagaError(f"{name} has fewer splats than {path} says. Export it again.")
        rows = [np.arange(part.start, part.stop) for part in parts]
        pieces.append(chunk.take(np.concatenate(rows)) if rows else chunk)
    yield Progress("Read splats", len(names), len(names))
    return _joined(pieces, path)


def _leaves(node: Node, path: Path, depth: int) -> Iterator[Node]:
    if depth > _MOST_DEPTH:
        raise GagaError(f"{path} is damaged: its tree is deeper than {_MOST_DEPTH} levels.")
    if node.lods or not node.children:
        yield node
    for child in node.children:
        yield from _leaves(child, path, depth + 1)


def _level(name: str) -> int:
    if not name.isdecimal() or len(name) > 4:
        raise GagaError(f"lod-meta.json is damaged: {name[:20]!r} is no level of detail.")
    return int(name)


def chunk_path(path: Path, name: str) -> Path:
    """The meta.json of a chunk; ``GagaError`` when it leads out of the folder."""
    parts = PurePosixPath(name)
    inside = name and not parts.is_absolute() and ".." not in parts.parts and "\\" not in name
    if not inside or parts.name != META:
        raise GagaError(f"{path} names {name!r}, which is no {META} in its folder.")
    return path.parent / Path(*parts.parts)


def _joined(pieces: list[Gaussians], path: Path) -> Gaussians:
    """All pieces; those with less view-dependent color get zeros."""
    n_rest = max(piece.sh.shape[1] for piece in pieces) - 1
    out = room_for(sum(len(piece) for piece in pieces), 1 + n_rest, path.name)
    first = 0
    for piece in pieces:
        part = slice(first, first + len(piece))
        out.means[part], out.quats[part] = piece.means, piece.quats
        out.log_scales[part] = piece.log_scales
        out.logit_opacities[part] = piece.logit_opacities
        out.sh[part] = 0
        out.sh[part, : piece.sh.shape[1]] = piece.sh
        first += len(piece)
    return replace(out, comments=pieces[0].comments)
