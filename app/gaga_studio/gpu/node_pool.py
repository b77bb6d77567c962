"""A pool of fixed size that holds nodes of a tree: the one that was drawn longest ago gives way.

To buffers and depth sort the pool is a scene of its own: each of its rows stands for a row of the
opened scene and takes that one's state, placement and group.
"""

import numpy as np

from gaga_core.arrays import AnyArray, BoolArray, FloatArray, IntArray, LongArray
from gaga_core.gaussians import Gaussians
from gaga_core.scene.lod.cut import covers_of
from gaga_core.scene.lod.tree import NODE
from gaga_core.scene.scene import Revision, Scene, State
from gaga_studio.gpu import sort_kernels
from gaga_studio.gpu.buffers import SceneBuffers
from gaga_studio.gpu.node_reader import ReadNode
from gaga_studio.gpu.packing import words_of_colors
from gaga_studio.gpu.sorter import Rows

_NONE = -1
_COLUMNS = ("labels", "state", "placement", "source")


class NodePool:
    """Slots of `NODE` rows each, and the columns of these rows."""

    def __init__(self, n_slots: int, n_nodes: int, scene: Scene) -> None:
        n, n_sh = n_slots * NODE, scene.gaussians.sh.shape[1]
        self.represents: IntArray = np.zeros(n, np.int32)  # row of the opened scene
        self._means: FloatArray = np.zeros((n, 3), np.float32)
        self._reach: FloatArray = np.zeros(n, np.float32)
        self._scores: FloatArray = np.zeros(n, np.float32)
        self._covers: FloatArray = np.zeros(n, np.float32)  # see `occlusion.covers_of`
        self._is_placed: BoolArray = np.zeros(n, np.bool_)  # no placement moves these rows
        self._node_in: IntArray = np.full(n_slots, _NONE, np.int32)
        self._counts: IntArray = np.zeros(n_slots, np.int32)
        self._slots: IntArray = np.full(n_nodes, _NONE, np.int32)  # of each node
        self._used: LongArray = np.zeros(n_slots, np.int64)  # pull in which each was wanted last
        # Rows of a slot that left the picture may still be sorted or drawn: they stay until an
        # order of this ticket is drawn.
        self._busy_until: LongArray = np.zeros(n_slots, np.int64)
        self._sorted: IntArray = np.zeros(0, np.int32)  # slots of the last sort job
        self._overlaid: dict[str, tuple[AnyArray, AnyArray]] = {}  # given column, and gathered
        self._seen: tuple[object, ...] = ()
        self.scene = self._scene_of(scene, n, n_sh)

    def _scene_of(self, scene: Scene, n: int, n_sh: int) -> Scene:
        nothing = np.zeros(1, np.float32)  # only the graphics card holds these columns
        gaussians = Gaussians(
            means=self._means,
            quats=np.broadcast_to(nothing, (n, 4)),
            log_scales=np.broadcast_to(nothing, (n, 3)),
            logit_opacities=np.broadcast_to(nothing, (n,)),
            sh=np.broadcast_to(nothing, (n, n_sh, 3)),
            comments=scene.gaussians.comments,
        )
        return Scene(
            gaussians=gaussians,
            **{name: getattr(scene, name)[self.represents] for name in _COLUMNS},
            placements=scene.placements,
            revision=Revision(),
        )

    # --- columns

    def follow(self, scene: Scene) -> None:
        """Take over what edits changed: columns of the rows that are stood for, and tables."""
        now, pool = scene.revision, self.scene
        seen = (scene, now.splats, now.labels, now.state, now.placement, now.placements, now.names)
        if seen == self._seen:
            return
        before, self._seen = self._seen, seen
        is_other = not before or before[:2] != seen[:2]
        for at, name in ((2, "labels"), (3, "state"), (4, "placement")):
            if is_other or before[at] != seen[at]:
                setattr(pool, name, getattr(scene, name)[self.represents])
                setattr(pool.revision, name, getattr(pool.revision, name) + 1)
                if name == "placement":
                    pool.placement[self._is_placed] = 0
        if is_other:
            pool.source = scene.source[self.represents]
        pool.placements, pool.names, pool.colors = scene.placements, scene.names, scene.colors
        pool.revision.placements += 1
        pool.confidence, pool.identities = scene.confidence, scene.identities
        pool.added = scene.added

    def overlaid(self, name: str, column: AnyArray | None) -> AnyArray | None:
        """A column (N, ...) of the opened scene for the rows of the pool; None as given."""
        if column is None:
            self._overlaid.pop(name, None)
            return None
        held = self._overlaid.get(name)
        if held is None or held[0] is not column:
            held = self._overlaid[name] = (column, column[self.represents])
        return held[1]

    # --- nodes

    def holds(self, nodes: IntArray) -> BoolArray:
        """Whether each of the nodes is here."""
        found: BoolArray = self._slots[nodes] != _NONE
        return found

    def resize(self, n_nodes: int, first: int) -> None:
        """Have room for so many nodes; those from ``first`` on are taken out."""
        gone = self._slots[first:]
        gone = gone[gone != _NONE]
        self._node_in[gone] = _NONE
        self.represents.reshape(-1, NODE)[gone] = 0  # their rows may be no more
        fresh = np.full(n_nodes - first, _NONE, np.int32)
        self._slots = np.concatenate([self._slots[:first], fresh])

    def forget(self, nodes: IntArray) -> None:
        """Take nodes out, as far as they are here: they are read again."""
        slots = self._slots[nodes]
        self._node_in[slots[slots != _NONE]] = _NONE
        self._slots[nodes] = _NONE

    def free_slots(self, drawn: IntArray, shown: int) -> list[int]:
        """Slots that nothing needs, the one that was drawn longest ago first.

        ``drawn``: nodes whose slots stay; ``shown``: ticket of the order that is drawn.
        """
        free = self._busy_until <= shown
        free[self._sorted] = False
        free[self._slots[drawn]] = False
        places = np.flatnonzero(free)
        found: list[int] = places[np.argsort(self._used[places], kind="stable")].tolist()
        return found

    def write(self, slot: int, read: ReadNode, scene: Scene, buffers: SceneBuffers) -> None:
        """Put a node into a slot, in place of what was there."""
        if (former := int(self._node_in[slot])) != _NONE:
            self._slots[former] = _NONE
        if (place := int(self._slots[read.node])) != _NONE:
            self._node_in[place] = _NONE
        self._slots[read.node], self._node_in[slot] = slot, read.node
        n = len(read.rows)
        self._counts[slot] = n
        first = slot * NODE
        part = slice(first, first + n)
        self.represents[part] = read.rows
        self._means[part] = read.means
        sort_kernels.reaches(read.log_scales, self._reach[part])
        sort_kernels.importance(read.log_scales, read.logit_opacities, self._scores[part])
        np.nan_to_num(self._scores[part], copy=False, nan=-np.inf)
        self._covers[part] = covers_of(read.log_scales, read.logit_opacities)
        for name in _COLUMNS:
            getattr(self.scene, name)[part] = getattr(scene, name)[read.rows]
        self._is_placed[part] = read.is_placed
        if read.is_placed:
            self.scene.placement[part] = 0
        for given, gathered in self._overlaid.values():
            gathered[part] = given[read.rows]
        buffers.write(read.packed, first, self._texels(part))

    def _texels(self, part: slice) -> dict[str, AnyArray]:
        """Rows of the columns that textures hold, by their names there."""
        pool = self.scene
        labels = self._overlaid.get("labels", (None, pool.labels))[1]
        found: dict[str, AnyArray] = {
            "labels": labels[part],
            "state": pool.state[part],
            "placement": pool.placement[part],
        }
        rows = Scene(
            gaussians=pool.gaussians,
            labels=pool.labels[part],
            state=pool.state[part],
            placement=pool.placement[part],
            source=pool.source[part],
            placements=pool.placements,
            confidence=pool.confidence,
            identities=pool.identities,
            added=pool.added,
        )
        confidence, identities = rows.confidence_of(), rows.identity_colors_of()
        if confidence is not None:
            found["confidence"] = confidence
        if identities is not None:
            found["identity"] = words_of_colors(identities)
        if "tint" in self._overlaid:
            found["tint"] = words_of_colors(self._overlaid["tint"][1][part])
        return found

    def want(self, nodes: IntArray, pull: int) -> None:
        """Note that these nodes, as far as they are here, are wanted in this pull."""
        slots = self._slots[nodes]
        self._used[slots[slots != _NONE]] = pull

    def samples(self, nodes: IntArray, every: int) -> tuple[FloatArray, FloatArray]:
        """Places (K, 3) of some splats of these nodes, and what each covers, and others for which
        it stands (K,). Hidden splats cover nothing, and moved ones are left out."""
        slots = self._slots[nodes]
        places = np.arange(0, NODE, every, dtype=np.int32)
        rows = (slots[:, None] * NODE + places)[places < self._counts[slots, None]]
        is_there = self.scene.state[rows] & np.uint8(State.HIDDEN | State.DELETED) == 0
        rows = rows[is_there & (self.scene.placement[rows] == 0)]
        return self._means[rows], self._covers[rows] * np.float32(every)

    def sort_job(self, nodes: IntArray, ticket: int) -> Rows:
        """The rows of these nodes, for the depth sort with this ticket."""
        slots = np.sort(self._slots[nodes])
        self._busy_until[self._sorted] = ticket
        self._sorted = slots
        places = np.arange(NODE, dtype=np.int32)
        is_filled: BoolArray = places < self._counts[slots, None]
        rows = (slots[:, None] * NODE + places)[is_filled].astype(np.int32, copy=False)
        return Rows(rows, self._reach, self._scores)
