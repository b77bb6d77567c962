"""Which splats a pixel may show: what a click in a large scene looks at."""

import threading
from dataclasses import replace

import numpy as np

from gaga_core.arrays import FloatArray, IntArray
from gaga_core.camera import Camera
from gaga_core.raster.base import NEAR
from gaga_core.scene.lod.edited import node_facts, placed_boxes
from gaga_core.scene.lod.tree import NODE, LodTree
from gaga_core.scene.scene import Scene

_MARGIN = 4.0  # pixels: the blur of small splats, and more


class PickBoxes:
    """A tree, and the boxes of its nodes where the splats of a scene stand.

    They are looked up when the first one asks: after an edit that is the thread of what lies under
    the mouse, not the one that draws.
    """

    def __init__(self, tree: LodTree, scene: Scene) -> None:
        self.tree = tree
        # Edits replace columns, never change them in place: this is the scene as it is now.
        self._scene = replace(scene)
        self._boxes: FloatArray | None = None
        self._looking = threading.Lock()

    @property
    def boxes(self) -> FloatArray:
        """Boxes (M, 6) of the nodes under the edits of the scene."""
        with self._looking:
            if self._boxes is None:
                tree, scene = self.tree, self._scene
                is_moved = scene.placement[: len(tree)].any()
                self._boxes = tree.boxes
                if is_moved:
                    self._boxes = placed_boxes(tree, node_facts(tree, scene), scene.placements)
            return self._boxes

    def rows_at(self, camera: Camera, u: float, v: float, n: int) -> IntArray:
        """Rows (K,) ascending, of ``n`` splats, whose nodes the ray of a pixel may meet.

        Splats that were added behind those of the tree are all among them.
        """
        # Imported when first needed: importing numba takes a large part of the launch time.
        from gaga_core.scene.lod.cut_kernels import node_errors

        tree, K = self.tree, camera.K
        n_leaves = int(tree.first_nodes[1])
        errors, seen = np.empty(n_leaves, np.float32), np.empty(n_leaves, np.bool_)
        # A picture of the one pixel.
        lens = np.array([K[0, 0], K[1, 1], K[0, 2] - u, K[1, 2] - v, 0, 0, NEAR, _MARGIN])
        pose = np.ascontiguousarray(camera.cam_from_world[:3], np.float64)
        leaves = self.boxes[:n_leaves]
        node_errors(leaves, tree.details[:n_leaves], pose, lens, 0.0, errors, seen)
        spans = [
            tree.order[leaf * NODE : min((leaf + 1) * NODE, len(tree))]
            for leaf in np.flatnonzero(seen)
        ]
        added = np.arange(len(tree), n, dtype=np.int32)
        return np.sort(np.concatenate([*spans, added]))
