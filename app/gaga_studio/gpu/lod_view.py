"""Level of detail of the picture: the cut of the tree that is drawn, and how it changes."""

from dataclasses import dataclass, replace

import numpy as np

from gaga_core.arrays import AnyArray, BoolArray, DoubleArray, FloatArray, IntArray
from gaga_core.camera import Camera
from gaga_core.errors import GagaError
from gaga_core.scene.lod.cut import choose_cut, drawn_nodes, hidden_nodes, parent_of, picture_shares
from gaga_core.scene.lod.edited import NodeFacts, node_facts, placed_boxes
from gaga_core.scene.lod.tree import FAN, NODE, LodTree
from gaga_core.scene.scene import Scene
from gaga_studio.gpu.buffers import SceneBuffers
from gaga_studio.gpu.node_pool import NodePool
from gaga_studio.gpu.node_reader import NodeReader
from gaga_studio.gpu.sorter import Rows

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
        firsts, n_children = self._children(finer)
        steps = np.arange(FAN)
        children = np.minimum(firsts[:, None] + steps, firsts[:, None] + n_children[:, None] - 1)
        here = self._pool.holds(children).all(axis=1)
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
        changes: DoubleArray = shares * weights * self._seen[nodes]
        return changes

    def _ask(self, drawn: IntArray) -> None:
        """Let the reader read what is missing for the next steps: what makes room comes first."""
        coarser, finer = self._coarser(drawn), self._finer(drawn)
        firsts, n_children = self._children(finer)
        children = (firsts[:, None] + np.arange(FAN))[np.arange(FAN) < n_children[:, None]]
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
        firsts, n_children = self._children(parents)
        steps = np.arange(FAN)
        children = np.minimum(firsts[:, None] + steps, firsts[:, None] + n_children[:, None] - 1)
        found: IntArray = parents[~self._divided[children].any(axis=1)]
        return found

    def _children(self, nodes: IntArray) -> tuple[IntArray, IntArray]:
        """First child of each node above level 0, and how many there are."""
        firsts = self.tree.first_nodes
        levels = np.searchsorted(firsts, nodes, side="right") - 1
        first = firsts[levels - 1] + (nodes - firsts[levels]) * FAN
        return first, np.minimum(FAN, firsts[levels] - first)
