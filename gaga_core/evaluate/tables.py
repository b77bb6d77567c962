"""One table of several variants of the method on one scene."""

from collections.abc import Sequence
from dataclasses import asdict, dataclass

import numpy as np

from gaga_core.evaluate.metrics import Score
from gaga_core.evaluate.sparse import iou_drop

HEADINGS = (
    "variant",
    "views",
    "IoU",
    "precision",
    "recall",
    "IoU, void",
    "P, void",
    "R, void",
    "groups",
    "seconds",
    "IoU drop",
)


@dataclass(frozen=True)
class VariantRow:
    """One variant on one choice of train views."""

    variant: str  # id: "robust", "tracker", ...
    title: str  # for people
    with_void: Score
    without_void: Score
    n_groups: int  # groups that own a Gaussian; of a frame's masks for the per-frame bound
    seconds: float  # wall time of association and vote, without reading and scoring
    n_views: int  # train views used
    share: float = 1.0  # of the train views
    seed: int = 0  # of the choice of views

    @property
    def key(self) -> tuple[str, float]:
        """Rows of one key differ only in their seed."""
        return self.variant, self.share


@dataclass(frozen=True)
class VariantTable:
    """All rows, in the order run, and what they were scored on."""

    scene: str
    images: tuple[str, ...]  # names of the scored views
    rows: tuple[VariantRow, ...]

    def of(self, variant: str, share: float = 1.0) -> tuple[VariantRow, ...]:
        """Rows of one variant, one a seed."""
        return tuple(row for row in self.rows if row.key == (variant, share))

    def drop(self, variant: str, share: float) -> float | None:
        """IoU drop (void left out), mean over seeds; None when a run is missing."""
        whole, sparse = self.of(variant), self.of(variant, share)
        if not whole or not sparse or share == 1.0:
            return None
        iou = _mean([row.without_void.iou for row in sparse])
        return iou_drop(whole[0].without_void.iou, iou)

    def to_json(self) -> dict[str, object]:
        """Plain values; ``drops`` holds the IoU drops by variant and share."""
        drops = [
            {"variant": variant, "share": share, "iou_drop": self.drop(variant, share)}
            for variant, share in self._keys()
            if share != 1.0
        ]
        rows = [asdict(row) for row in self.rows]
        return {"scene": self.scene, "images": list(self.images), "rows": rows, "drops": drops}

    def table(self) -> list[list[str]]:
        """Rows of text, headings first; several seeds of a choice of views are averaged."""
        result = [list(HEADINGS)]
        for variant, share in self._keys():
            rows, drop = self.of(variant, share), self.drop(variant, share)
            seeds = f", {len(rows)} seeds" if len(rows) > 1 else ""
            title = rows[0].title if share == 1.0 else f"{rows[0].title}, {share:.0%}{seeds}"
            text = [title, str(rows[0].n_views)]
            for scores in ([r.without_void for r in rows], [r.with_void for r in rows]):
                for name in ("iou", "precision", "recall"):
                    text.append(f"{100 * _mean([getattr(s, name) for s in scores]):.1f}")
            text.append(f"{_mean([row.n_groups for row in rows]):.0f}")
            text.append(f"{_mean([row.seconds for row in rows]):.1f}")
            text.append("" if drop is None else f"{100 * drop:.1f} %")
            result.append(text)
        return result

    def _keys(self) -> list[tuple[str, float]]:
        return list(dict.fromkeys(row.key for row in self.rows))


def _mean(values: Sequence[float]) -> float:
    return float(np.mean(values))
