"""Quality of each group of an association: its picture against the masks that made it."""

import logging
from collections.abc import Mapping
from dataclasses import dataclass, field
from pathlib import Path

import msgspec
import numpy as np

from gaga_core.arrays import DoubleArray, FloatArray, IntArray
from gaga_core.errors import GagaError
from gaga_core.grouping.bank_file import bank_digest
from gaga_core.grouping.memory_bank import MemoryBank, groups_of_masks
from gaga_core.grouping.repair.view_evidence import Evidence
from gaga_core.grouping.votes import associated_labels, splat_groups
from gaga_core.io.files import atomic_write
from gaga_core.io.json_file import read_json
from gaga_core.progress import Progress, Stage
from gaga_core.raster.base import Rasterizer

_LOG = logging.getLogger(__name__)
STAGE = "Measure the objects"
FILE = "quality.json"  # the last measurement, in the folder of our work in a scene folder
SIDE = 480  # longest side in pixels of the pictures that are compared


@dataclass(frozen=True)
class ViewQuality:
    """A group in one view."""

    view: str
    agreement: float  # IoU of its rendered pixels with its masks'
    n_mask: int  # pixels of its masks, of the small picture
    n_shown: int  # pixels that show it


@dataclass(frozen=True)
class GroupQuality:
    """A group over all views in which a mask joined it."""

    group: int
    agreement: float  # mean of its views'
    confidence: float  # mean over its splats, 0..1
    views: tuple[ViewQuality, ...] = ()  # the worst first

    @property
    def n_views(self) -> int:
        """Views with a mask of the group."""
        return len(self.views)


@dataclass(frozen=True, eq=False)
class Quality:
    """Result of `quality_stage`."""

    groups: Mapping[int, GroupQuality] = field(default_factory=dict)

    def agreement(self, ids: IntArray) -> DoubleArray:
        """Agreement (G,) of groups, -1 where nothing is known."""
        found = [self.groups.get(int(group)) for group in ids]
        return np.array([-1.0 if one is None else one.agreement for one in found])


class _Kept(msgspec.Struct, frozen=True):
    """Content of `FILE`."""

    bank: str  # digest of the bank whose masks were compared
    labels: str  # digest of the groups of the splats
    quality: Quality


def write_quality(work: Path, quality: Quality, bank: MemoryBank, labels_digest: str) -> None:
    """Keep a measurement in ``work``, in place of the last one. ``GagaError``: it cannot be."""
    with atomic_write(work / FILE) as temporary:
        temporary.write_bytes(msgspec.json.encode(_Kept(bank_digest(bank), labels_digest, quality)))


def read_quality(work: Path, bank: MemoryBank) -> dict[str, Quality]:
    """Read the measurement that ``work`` has of ``bank``, by digest of the groups.

    Empty without one, where it is of another bank, and where its file is damaged.
    """
    file = work / FILE
    if not file.is_file():
        return {}
    try:
        kept = read_json(file, _Kept, "")
    except GagaError as error:
        _LOG.warning("the measured quality is left out: %s", error)
        return {}
    return {kept.labels: kept.quality} if kept.bank == bank_digest(bank) else {}


def quality_stage(
    evidence: Evidence,
    bank: MemoryBank,
    labels: IntArray,  # (N,)
    confidence: FloatArray | None,  # (N,) 0..1
    rasterizer: Rasterizer,
    *,
    side: int = SIDE,
) -> Stage[Quality]:
    """Compare every group's rendered pixels with the masks that joined it, view by view.

    A view counts for a group when a mask of it joined: a view without one says nothing (the
    segmenter may have dropped the mask). Pictures are at most ``side`` pixels long; where the
    leading group weighs little there is background, as in exported group maps.
    """
    views, masks = evidence.views, evidence.masks
    groups = groups_of_masks(bank, [camera.name for camera in views])
    found: dict[int, list[ViewQuality]] = {}
    for i, camera in enumerate(views):
        yield Progress(STAGE, i, len(views), camera.name)
        small = camera.at_most(side)
        own = associated_labels(
            masks.load(camera.name, small.width, small.height), groups[camera.name]
        )
        shown = splat_groups(rasterizer, evidence.gaussians, small, labels)
        for group, one in compared(camera.name, own, shown).items():
            found.setdefault(group, []).append(one)
    sure = _mean_confidence(labels, confidence)
    return Quality(
        {
            group: GroupQuality(
                group,
                float(np.mean([one.agreement for one in views_])),
                sure.get(group, 0.0),
                tuple(sorted(views_, key=lambda one: (one.agreement, one.view))),
            )
            for group, views_ in sorted(found.items())
        }
    )


def compared(view: str, own: IntArray, shown: IntArray) -> dict[int, ViewQuality]:
    """For each group with a mask in a view: its masks ``own`` (H, W) against ``shown`` (H, W)."""
    ids, dense = np.unique(np.stack([own, shown]), return_inverse=True)
    a, b = dense.reshape(2, -1)
    n = len(ids)
    both = np.bincount(a[a == b], minlength=n)
    n_own, n_shown = np.bincount(a, minlength=n), np.bincount(b, minlength=n)
    return {
        int(ids[k]): ViewQuality(
            view,
            float(both[k] / (n_own[k] + n_shown[k] - both[k])),
            int(n_own[k]),
            int(n_shown[k]),
        )
        for k in range(n)
        if ids[k] > 0 and n_own[k] > 0
    }


def _mean_confidence(labels: IntArray, confidence: FloatArray | None) -> dict[int, float]:
    if confidence is None or len(labels) == 0:
        return {}
    ids, dense = np.unique(labels, return_inverse=True)
    total = np.bincount(dense, weights=confidence.astype(np.float64))
    mean = total / np.bincount(dense)
    return {int(group): float(value) for group, value in zip(ids, mean, strict=True)}
