"""Level of detail of the picture: the cut of the tree that is drawn, and how it changes."""

import logging
import threading
from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from gaga_core.arrays import AnyArray, BoolArray, DoubleArray, FloatArray, IntArray, LongArray
from gaga_core.camera import Camera
from gaga_core.errors import GagaError
from gaga_core.gaussians import Gaussians
from gaga_core.scene.lod.cut import (
    choose_cut,
    covers_of,
    drawn_nodes,
    hidden_nodes,
    parent_of,
    picture_shares,
)
from gaga_core.scene.lod.edited import NodeFacts, merged_again, node_facts, placed_boxes
from gaga_core.scene.lod.tree import FAN, NODE, LodTree
from gaga_core.scene.scene import Revision, Scene, State
from gaga_studio.gpu import sort_kernels
from gaga_studio.gpu.buffers import PackedSplats, SceneBuffers, pack_splats, words_of_colors
from gaga_studio.gpu.sorter import Rows

# --- Reads nodes of a tree in a thread of its own, ready to be sent to the graphics card.

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
        finally:  # however the thread ended, no other may wait for it
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


# --- A pool of fixed size that holds nodes of a tree: the one that was drawn longest ago gives
# way.
# To buffers and depth sort the pool is a scene of its own: each of its rows stands for a row of
# the opened scene and takes that one's state, placement and group.

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
        return self._slots[nodes] != _NONE

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
        return places[np.argsort(self._used[places], kind="stable")].tolist()

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
        self._reach[part] = sort_kernels.reaches(read.log_scales)
        self._scores[part] = sort_kernels.importance(read.log_scales, read.logit_opacities)
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


_MOST_WRITES = 32  # nodes sent in one frame
_MOST_SWAPS = 16  # nodes that are replaced by finer or coarser ones in one frame
# Area that one frame may replace, of the picture's: with overlaps, which is why it is no share.
# A whole picture of it was measured to differ by 0.05 to 0.6 of 255.
_MOST_CHANGE = 2.0
_SAMPLES = 100_000  # splats that tell what is hidden
_FULL_ERROR = 6.0  # pixels: what shows less than this changes less
_POOL = 2.0  # splats that the pool holds, times the budget
_SPARE_SLOTS = 32
_MOST_AGAIN = 3  # level up to which nodes are merged again: 131,072 splats of level 0
_RESERVE = 8  # slots that only coarser nodes may take, which make room


@dataclass(frozen=True)
class Wish:
    """What a cut is chosen for, by value."""

    lens: object
    budget: int
    facts: int  # count of their changes
    is_opaque: bool
    is_drawn: bool  # a cut for this camera, of which it is known what it hides


def fits(tree: LodTree, scene: Scene, budget: int) -> bool:
    """Whether splats that were added behind those of the tree leave room for a cut of it."""
    return len(tree) <= len(scene) and 2 * (len(scene) - len(tree)) <= budget


class LodView:
    """The nodes of a tree that are drawn, those that are on the way, and the pool that holds them.

    One node at the top is there first; from then on a node is replaced by its children, or these by
    their parent, once they are in the pool: the picture never has a hole.
    """

    def __init__(self, tree: LodTree, scene: Scene, buffers: SceneBuffers, budget: int) -> None:
        self.tree, self.opened, self.budget = tree, scene, budget
        self._buffers = buffers
        self._counts, self._parents = tree.counts, parent_of(tree)
        n_slots = int(np.ceil(_POOL * budget / NODE)) + _SPARE_SLOTS
        self._pool = NodePool(min(n_slots, tree.n_nodes + _SPARE_SLOTS), tree.n_nodes, scene)
        low, high = tree.log_scale_range
        self._scale_range = (max(low, high - 40.0), max(high - max(low, high - 40.0), 1e-3))
        self._reader = NodeReader(tree, scene.gaussians, self._scale_range)
        buffers.open_pool(self._pool.scene, self._scale_range)
        self._divided: BoolArray = np.zeros(tree.n_nodes, np.bool_)
        self._target: BoolArray = self._divided
        self._seen: BoolArray = np.ones(tree.n_nodes, np.bool_)
        self._errors = np.zeros(tree.n_nodes, np.float32)
        self._drawn: IntArray = np.zeros(0, np.int32)
        self._facts: NodeFacts = node_facts(tree, scene)
        self._facts_of: tuple[int, int, int] = (-1, -1, -1)
        self._n_facts = 0
        self._again: BoolArray = np.zeros(tree.n_nodes, np.bool_)  # merged again after edits
        self._stale: BoolArray = np.zeros(tree.n_nodes, np.bool_)  # drawn as before an edit
        self._boxes: FloatArray = tree.boxes
        self._camera: Camera | None = None  # that the cut was chosen for
        self._is_new = True  # no cut was drawn as it was chosen
        self._wish: Wish | None = None
        self._extra: IntArray = np.zeros(0, np.int32)  # nodes of splats that were added
        self._grown = (-1, len(tree))  # count of changes of the splats, and how many there are
        self._pulls = 0
        self.version = 0  # grows when other nodes are drawn
        self.least_error = 0.0  # pixels, of the chosen cut

    @property
    def scene(self) -> Scene:
        """The pool as a scene: what buffers and depth sort see."""
        return self._pool.scene

    @property
    def n_drawn(self) -> int:
        """Splats of the nodes that are drawn."""
        return int(self._counts[self._drawn].sum()) + self._grown[1] - len(self.tree)

    @property
    def settled(self) -> bool:
        """Whether the chosen cut is drawn."""
        return self.error is not None or (
            len(self._drawn) > 0
            and np.array_equal(self._divided, self._target)
            and (self._wish is None or self._wish.is_drawn or not self._wish.is_opaque)
            and not self._stale[self._drawn].any()
            and bool(self._pool.holds(self._extra).all())
        )

    @property
    def error(self) -> GagaError | None:
        """Why no further nodes can be read."""
        return self._reader.error

    def pull(
        self, scene: Scene, camera: Camera, lens: object, shown: int, *, is_opaque: bool = True
    ) -> None:
        """Bring the cut up to date as far as nodes are there; ask for those that are not.

        ``shown``: ticket of the depth order that is drawn. ``is_opaque``: splats hide others.
        """
        self._pulls += 1
        self._follow(scene)
        self._choose(camera, lens, is_opaque=is_opaque)
        self._take(scene, shown)
        self._swap()

    def _take(self, scene: Scene, shown: int) -> None:
        """Send the nodes that were read, as far as there are slots."""
        free = self._pool.free_slots(self._needed(), shown)
        for read in self._reader.take(min(_MOST_WRITES, len(free))):
            node, is_extra = read.node, read.node >= self.tree.n_nodes
            is_late = read.edits != self._n_facts and not is_extra
            if is_late and (self._again[node] or read.is_placed):
                continue  # splats below it were edited meanwhile
            is_stale = not is_extra and self._stale[node]
            if is_extra or is_stale or self._divided[node] or len(free) > _RESERVE:
                self._pool.write(free.pop(0), read, scene, self._buffers)
                self.version += bool(is_extra or is_stale)
                if is_stale:
                    self._stale[node] = False

    def _needed(self) -> IntArray:
        """Nodes whose slots stay."""
        return np.concatenate([self._drawn, self._extra[self._pool.holds(self._extra)]])

    def wait(self) -> None:
        """Until nodes that were asked for are there: for saved pictures."""
        self._reader.wait()

    def sort_job(self, ticket: int) -> Rows:
        """Rows of the pool that may be in the picture, for the sort job with this ticket."""
        extra = self._extra[self._pool.holds(self._extra)]
        seen = self._drawn[self._seen[self._drawn]]
        return self._pool.sort_job(np.concatenate([seen, extra]), ticket)

    def overlaid(self, name: str, column: AnyArray | None) -> AnyArray | None:
        """See `NodePool.overlaid`."""
        return self._pool.overlaid(name, column)

    def release(self) -> None:
        """End the reader."""
        self._reader.release()

    def _follow(self, scene: Scene) -> None:
        now = scene.revision
        if (now.splats, len(scene)) != self._grown:
            self._grow(scene)
        facts_of = (now.state, now.placement, now.placements)
        if facts_of != self._facts_of:
            if facts_of[:2] != self._facts_of[:2]:
                self._facts = node_facts(self.tree, scene)
            self._boxes = placed_boxes(self.tree, self._facts, scene.placements)
            self._facts_of = facts_of
            self._n_facts += 1
            self._merge_again(scene)
        self._pool.follow(scene)

    def _merge_again(self, scene: Scene) -> None:
        """Have nodes merged again whose splats were torn apart by edits, or are not any more."""
        again = self._facts.torn.copy()
        again[: self.tree.first_nodes[1]] = False  # the splats themselves
        firsts = self.tree.first_nodes
        again[firsts[min(_MOST_AGAIN + 1, len(firsts) - 1)] :] = False
        changed = np.flatnonzero(again | self._again).astype(np.int32)
        self._again = again
        self._reader.edit(scene, again, self._n_facts)
        is_drawn = np.isin(changed, self._drawn)
        self._stale[changed[is_drawn]] = True
        self._pool.forget(changed[~is_drawn])

    def _grow(self, scene: Scene) -> None:
        """Splats were added behind those of the tree, or taken away: nodes of their own hold them,
        which are always drawn."""
        n_nodes, n = self.tree.n_nodes, len(self.tree)
        kept = min(scene.revision.rows_kept_since(self._grown[0]), self._grown[1], len(scene))
        first = n_nodes + max(kept - n, 0) // NODE
        last = n_nodes + -(-(len(scene) - n) // NODE)
        self._reader.follow(scene.gaussians, min(first, last))
        self._pool.resize(last, min(first, last))
        self._extra = np.arange(n_nodes, last, dtype=np.int32)
        self._grown = (scene.revision.splats, len(scene))
        self.version += 1

    def _choose(self, camera: Camera, lens: object, *, is_opaque: bool) -> None:
        former = self._wish
        is_drawn = is_opaque and np.array_equal(self._divided, self._target)
        is_drawn &= former is not None and former.lens == lens
        wish = Wish(lens, self.budget, self._n_facts, is_opaque, is_drawn)
        if wish == former or (former is not None and replace(wish, is_drawn=True) == former):
            return
        self._wish, self._camera = wish, camera
        cut = choose_cut(
            self.tree,
            self._boxes,
            camera,
            self.budget - len(self._extra) * NODE,
            before=self._divided,
            exact=self._facts.mixed,
            # It takes milliseconds: not while the camera moves.
            hidden=self._hidden(camera) if is_drawn else None,
        )
        self._target, self._errors = cut.divided, cut.errors
        self._seen = cut.seen & ~self._facts.gone
        self.least_error = cut.least_error

    def _hidden(self, camera: Camera) -> BoolArray:
        """Nodes (M,) behind what is drawn."""
        drawn = self._drawn[self._seen[self._drawn]]
        every = max(int(self._counts[drawn].sum()) // _SAMPLES, 1)
        return hidden_nodes(self._boxes, *self._pool.samples(drawn, every), camera)

    def _swap(self) -> None:
        """Go from the drawn cut towards the chosen one, and ask for what is missing."""
        if len(self._drawn) == 0:
            top = np.array([self.tree.n_nodes - 1], np.int32)
            if not self._pool.holds(top)[0]:
                self._reader.ask(top.tolist())
                return
            self._drawn = top
            self.version += 1
        drawn, left = self._drawn, _MOST_SWAPS
        change = np.inf if self._is_new else _MOST_CHANGE
        while left > 0 and (swapped := self._step(drawn, left, change))[0] > 0:
            left, change = left - swapped[0], change - swapped[1]
            drawn = drawn_nodes(self.tree, self._divided)
        if left < _MOST_SWAPS:
            self._drawn = drawn
            self.version += 1
        self._is_new &= not np.array_equal(self._divided, self._target)
        self._ask(drawn)

    def _step(self, drawn: IntArray, most: int, change: float) -> tuple[int, float]:
        """Swap nodes whose successors are in the pool; how many were, and how much that changes.

        At most so many, and so much unless one alone is more.
        """
        coarser, finer = self._coarser(drawn), self._finer(drawn)
        ready = coarser[self._pool.holds(coarser)]
        here = self._pool.holds(self._children(finer)).all(axis=1)
        found = np.concatenate([ready, finer[here]])[:most]
        changes = np.cumsum(self._changes(found))
        n = int(np.searchsorted(changes, change, side="right"))
        if most == _MOST_SWAPS:  # the first of this frame
            n = max(n, min(1, len(found)))
        self._divided[found[:n]] ^= True
        return n, float(changes[n - 1]) if n else 0.0

    def _changes(self, nodes: IntArray) -> DoubleArray:
        """How much of the picture (K,), 0..1, is another one when these nodes are swapped."""
        assert self._camera is not None
        shares = picture_shares(self._counts[nodes], self._errors[nodes], self._camera)
        weights = np.minimum(self._errors[nodes] / _FULL_ERROR, 1.0)
        return shares * weights * self._seen[nodes]

    def _ask(self, drawn: IntArray) -> None:
        """Let the reader read what is missing for the next steps: what makes room comes first."""
        coarser, finer = self._coarser(drawn), self._finer(drawn)
        children = self._children(finer)
        is_filler = np.diff(children, axis=1, prepend=-1) == 0  # where a node has fewer than others
        children = children[~is_filler]
        stale = drawn[self._stale[drawn]]
        wanted = np.concatenate([self._extra, stale, coarser, children]).astype(np.int32)
        self._pool.want(np.concatenate([drawn, wanted]), self._pulls)
        missing = ~self._pool.holds(wanted)
        missing[len(self._extra) : len(self._extra) + len(stale)] = True
        self._reader.ask(wanted[missing].tolist())

    def _finer(self, drawn: IntArray) -> IntArray:
        """Drawn nodes that are to be divided, those first that show least."""
        found = drawn[self._target[drawn]]
        return found[np.argsort(-self._errors[found], kind="stable")]

    def _coarser(self, drawn: IntArray) -> IntArray:
        """Divided nodes that should not be, whose children are all drawn."""
        parents = self._parents[drawn]
        parents = np.unique(parents[parents >= 0])
        parents = parents[~self._target[parents]]
        return parents[~self._divided[self._children(parents)].any(axis=1)]

    def _children(self, nodes: IntArray) -> IntArray:
        """Children (K, FAN) of each node above level 0; of fewer the last one several times."""
        firsts = self.tree.first_nodes
        levels = np.searchsorted(firsts, nodes, side="right") - 1
        first = firsts[levels - 1] + (nodes - firsts[levels]) * FAN
        return np.minimum(first[:, None] + np.arange(FAN), firsts[levels, None] - 1)
