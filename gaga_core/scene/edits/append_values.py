"""The edit that adds splats to the scene: of another file, or made by another edit's work."""

from collections.abc import Sequence
from dataclasses import dataclass, replace
from types import MappingProxyType

import numpy as np

from gaga_core.arrays import AnyArray, FloatArray
from gaga_core.gaussians import Gaussians
from gaga_core.scene.edits.values import check_length
from gaga_core.scene.index_set import PackedInts
from gaga_core.scene.scene import Added, Placements, Scene, State


@dataclass(frozen=True, eq=False)
class AppendSplats:
    """Splats at the end of the scene, on a placement row of their own.

    SH get the higher degree of the two, columns that one side lacks are zero there.
    """

    title: str
    n: int  # splats of the scene before
    n_rows: int  # of its placement table
    n_sh: int  # SH coefficients
    columns: tuple[str, ...]  # names of its extra columns
    splats: Gaussians  # as read from the file, or as they were made
    labels: PackedInts  # of the added splats
    added: Added
    state: State = State.SELECTED

    @property
    def nbytes(self) -> int:
        """Bytes held: the splats, for redo."""
        g = self.splats
        columns = (g.means, g.quats, g.log_scales, g.logit_opacities, g.sh, *g.extra.values())
        return sum(int(column.nbytes) for column in columns) + self.labels.nbytes

    def apply(self, scene: Scene) -> None:
        """Append the splats."""
        check_length(scene, self.n)
        k = len(self.splats)
        gaussians = joined(scene.gaussians, self.splats)
        labels = np.concatenate([scene.labels, self.labels.values()])
        placement = np.concatenate([scene.placement, np.full(k, self.n_rows, np.int32)])
        state = np.concatenate([scene.state, np.full(k, self.state, np.uint8)])
        rows = np.arange(self.added.first, self.added.first + k, dtype=np.int64)
        source = np.concatenate([scene.source, rows])
        table, fresh = scene.placements, Placements.identity()
        scene.placements = Placements(
            np.concatenate([table.matrix, fresh.matrix]),
            np.concatenate([table.color, fresh.color]),
            np.concatenate([table.opacity, fresh.opacity]),
        )
        scene.gaussians, scene.labels, scene.placement = gaussians, labels, placement
        scene.state, scene.source = state, source
        scene.added = (*scene.added, self.added)
        self._bump(scene)

    def revert(self, scene: Scene) -> None:
        """Cut the splats off, and what came into the scene with them."""
        check_length(scene, self.n + len(self.splats))
        g, n, table = scene.gaussians, self.n, scene.placements
        scene.gaussians = replace(
            g,
            means=g.means[:n],
            quats=g.quats[:n],
            log_scales=g.log_scales[:n],
            logit_opacities=g.logit_opacities[:n],
            sh=np.ascontiguousarray(g.sh[:n, : self.n_sh]),
            extra=MappingProxyType({name: g.extra[name][:n] for name in self.columns}),
        )
        scene.labels, scene.placement = scene.labels[:n], scene.placement[:n]
        scene.state, scene.source = scene.state[:n], scene.source[:n]
        rows = self.n_rows
        scene.placements = Placements(table.matrix[:rows], table.color[:rows], table.opacity[:rows])
        scene.added = scene.added[:-1]
        self._bump(scene)

    def _bump(self, scene: Scene) -> None:
        scene.revision.splats_changed(self.n)
        scene.revision.labels += 1
        scene.revision.state += 1
        scene.revision.placement += 1
        scene.revision.placements += 1


def joined(first: Gaussians, then: Gaussians) -> Gaussians:
    """Splats of two files as one set; comments are those of the first.

    SH get the higher degree of the two. A column that one side lacks is zero there; one that both
    have keeps the dtype of the first.
    """
    n_sh = max(first.sh.shape[1], then.sh.shape[1])
    names = [*first.extra, *(name for name in then.extra if name not in first.extra)]
    extra = {name: _column([first, then], name) for name in names}
    return replace(
        first,
        means=np.concatenate([first.means, then.means]),
        quats=np.concatenate([first.quats, then.quats]),
        log_scales=np.concatenate([first.log_scales, then.log_scales]),
        logit_opacities=np.concatenate([first.logit_opacities, then.logit_opacities]),
        sh=np.concatenate([_with_sh(first.sh, n_sh), _with_sh(then.sh, n_sh)]),
        extra=MappingProxyType(extra),
    )


def _with_sh(sh: FloatArray, n_sh: int) -> FloatArray:
    if sh.shape[1] == n_sh:
        return sh
    return np.concatenate([sh, np.zeros((len(sh), n_sh - sh.shape[1], 3), np.float32)], axis=1)


def _column(parts: Sequence[Gaussians], name: str) -> AnyArray:
    dtype = next(part.extra[name].dtype for part in parts if name in part.extra)
    with np.errstate(invalid="ignore"):
        pieces = [
            part.extra[name].astype(dtype) if name in part.extra else np.zeros(len(part), dtype)
            for part in parts
        ]
    return np.concatenate(pieces)
