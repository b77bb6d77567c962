"""Reads nodes of a tree in a thread of its own, ready to be sent to the graphics card."""

import logging
import threading
from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from gaga_core.arrays import BoolArray, FloatArray, IntArray
from gaga_core.errors import GagaError
from gaga_core.gaussians import Gaussians
from gaga_core.scene.lod.edited import merged_again
from gaga_core.scene.lod.tree import NODE, LodTree
from gaga_core.scene.scene import Scene
from gaga_studio.gpu.packing import PackedSplats, pack_splats

_LOG = logging.getLogger(__name__)
_MOST_WAITING = 64  # nodes that were read and not taken
_NEVER = 1 << 31


@dataclass(frozen=True, eq=False)
class ReadNode:
    """The splats of a node."""

    node: int
    means: FloatArray  # (K, 3)
    log_scales: FloatArray  # (K, 3)
    logit_opacities: FloatArray  # (K,)
    rows: IntArray  # (K,) of the scene: those that the splats are, or that count most in them
    packed: PackedSplats
    edits: int  # count of edits after which it was read, see `NodeReader.edit`
    is_placed: bool  # whether the splats stand where they are drawn: no placement moves them


class NodeReader:
    """One thread; what was asked for last is read next, in the order of the list."""

    def __init__(self, tree: LodTree, opened: Gaussians, scale_range: tuple[float, float]) -> None:
        self._tree, self._opened, self._scale_range = tree, opened, scale_range
        self._changed = threading.Condition()
        self._wanted: list[int] = []
        self._read: list[ReadNode] = []
        self._reading = -1
        self._first_changed = _NEVER  # node, while one of the former ones is being read
        self._ended = False
        self._edited: tuple[Scene | None, BoolArray, int] = (None, np.zeros(0, np.bool_), 0)
        self.error: GagaError | None = None  # after which nothing is read any more
        self._thread = threading.Thread(target=self._work, name="gaga-lod", daemon=True)
        self._thread.start()

    def ask(self, nodes: Sequence[int]) -> None:
        """Read these nodes, the first one first; what was asked for before is forgotten."""
        with self._changed:
            coming = {self._reading, *(read.node for read in self._read)}
            self._wanted = [node for node in nodes if node not in coming]
            self._changed.notify_all()

    def follow(self, gaussians: Gaussians, first: int) -> None:
        """Read further splats from these columns; nodes from ``first`` on are not those any more
        that were asked for."""
        with self._changed:
            self._opened = gaussians
            self._first_changed = first
            self._wanted = [node for node in self._wanted if node < first]
            self._read = [read for read in self._read if read.node < first]

    def edit(self, scene: Scene, again: BoolArray, count: int) -> None:
        """Merge the nodes of ``again`` (M,) from the splats of ``scene`` from now on."""
        with self._changed:
            self._edited = replace(scene), again, count

    def take(self, most: int) -> list[ReadNode]:
        """At most so many nodes that were read."""
        with self._changed:
            taken, self._read = self._read[:most], self._read[most:]
            self._changed.notify_all()
            return taken

    def wait(self, timeout: float = 60.0) -> None:
        """Until there is something to take, or nothing is to be read: for pictures to save."""
        with self._changed:
            self._changed.wait_for(lambda: bool(self._read) or self._is_idle(), timeout)

    def release(self) -> None:
        """End the thread."""
        with self._changed:
            self._ended = True
            self._changed.notify_all()
        self._thread.join(timeout=10)

    def _is_idle(self) -> bool:
        return self._ended or (not self._wanted and self._reading < 0)

    def _work(self) -> None:
        try:
            while (node := self._next()) is not None:
                found = self._one(node)
                with self._changed:
                    if node < self._first_changed:
                        self._read.append(found)
                    self._first_changed = _NEVER
                    self._reading = -1
                    self._changed.notify_all()
        except GagaError as error:
            self.error = error
        except Exception as error:  # noqa: BLE001  or a picture to save would wait forever
            _LOG.exception("level of detail")
            self.error = GagaError(f"The level of detail cannot be read ({error}).")
        finally:  # however the thread ended, nobody may wait for it
            with self._changed:
                self._ended, self._reading = True, -1
                self._changed.notify_all()

    def _one(self, node: int) -> ReadNode:
        extra = node - self._tree.n_nodes
        scene, again, count = self._edited
        is_again = scene is not None and extra < 0 and bool(again[node])
        if scene is not None and is_again:
            splats, rows = merged_again(self._tree, node, scene)
        elif extra < 0:
            splats, rows = self._tree.read(node, self._opened)
        else:  # splats that were added since: in the order of the scene
            first = len(self._tree) + extra * NODE
            rows = np.arange(first, min(first + NODE, len(self._opened)), dtype=np.int32)
            splats = self._opened.take(rows)
        return ReadNode(
            node,
            splats.means,
            splats.log_scales,
            splats.logit_opacities,
            rows,
            pack_splats(splats, 0, len(splats), self._scale_range),
            count,
            is_again,
        )

    def _next(self) -> int | None:
        with self._changed:
            self._changed.wait_for(
                lambda: self._ended or (self._wanted and len(self._read) < _MOST_WAITING)
            )
            if self._ended:
                return None
            self._reading = self._wanted.pop(0)
            return self._reading
