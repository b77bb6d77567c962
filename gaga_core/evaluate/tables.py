"""One table of several variants of the method on one scene."""

from collections.abc import Mapping, Sequence
from dataclasses import asdict, dataclass

import numpy as np

from gaga_core.evaluate.metrics import VOID_LEFT_OUT, Score
from gaga_core.evaluate.published import ABLATION, THRESHOLD_MIOU, THRESHOLD_TABLE
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
    "published",
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
        rows = [asdict(row) | _published(row) for row in self.rows]
        return {"scene": self.scene, "images": list(self.images), "rows": rows, "drops": drops}

    def table(self) -> list[list[str]]:
        """Rows of text, headings first; several seeds of a choice of views are averaged.

        Columns "published" and "IoU drop" are left out where no row has them.
        """
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
            text.append(published_text(variant) if share == 1.0 else "")
            text.append("" if drop is None else f"{100 * drop:.1f} %")
            result.append(text)
        kept = [
            column
            for column, heading in enumerate(HEADINGS)
            if heading not in ("published", "IoU drop") or any(row[column] for row in result[1:])
        ]
        return [[row[column] for column in kept] for row in result]

    def notes(self) -> list[str]:
        """How predictions are counted, and what the column "published" means where there is one."""
        variants = [variant for variant, share in self._keys() if share == 1.0]
        found = [VOID_LEFT_OUT, "Columns with void: it is a label, and every id is a prediction."]
        if any("identities by" in row.title for row in self.rows):
            found.append("Scored: rendered identities where a row says so, else the groups.")
        if any(published_text(v) and not _miou_at(v) for v in variants):
            found.append(
                "Published: IoU/P/R of the paper's ablation on Replica, void as a label; masks of "
                "SAM, of SAM 2 for its tracks."
            )
            others = ", ".join(
                f"{row.method} ({row.masks}) {published_text(name)}"
                for name, row in ABLATION.items()
                if name not in variants
            )
            found.append(f"Published rows that are not in this table: {others}.")
        if any(_miou_at(v) for v in variants):
            found.append("Published at thresholds: mIoU of figurines/ramen/teatime (LERF-Mask).")
        return found

    def _keys(self) -> list[tuple[str, float]]:
        return list(dict.fromkeys(row.key for row in self.rows))


def published_text(variant: str) -> str:
    """What the paper prints for a variant: on its own scenes, with masks of SAM, void as a label.

    IoU/P/R, "46.2/39.5/50.6"; at an overlap threshold mIoU of three scenes; empty where it prints
    nothing.
    """
    found = ABLATION.get(variant)
    values = found.values if found is not None else tuple(_miou_at(variant).values())
    return "/".join(f"{value:.1f}" for value in values)


def _published(row: VariantRow) -> dict[str, object]:
    """The published figures of a row, for machines; nothing where there are none."""
    if row.share != 1.0:
        return {}
    of_threshold, found = _miou_at(row.variant), ABLATION.get(row.variant)
    if of_threshold:
        return {"published": {"table": THRESHOLD_TABLE, "miou": dict(of_threshold)}}
    if found is None:
        return {}
    iou, precision, recall = found.values
    scores = {"iou": iou, "precision": precision, "recall": recall}
    return {"published": {"table": found.table, "masks": found.masks, **scores}}


def _miou_at(variant: str) -> Mapping[str, float]:
    """Published mIoU by scene at the overlap threshold of a variant "threshold 0.2"."""
    kind, _, value = variant.partition(" ")
    return THRESHOLD_MIOU.get(float(value), {}) if kind == "threshold" else {}


def _mean(values: Sequence[float]) -> float:
    return float(np.mean(values))
