"""Is a model of structure from motion right? A wrong one must not pass without a word.

Mapping can place every photo and still be wrong: two halves turned against each other, a focal
length that ran away, a wall that stands twice. The strongest witness is what the mapper did not
use up: the verified matches of every pair of photos, held against the poses of the model.
"""

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Literal

import numpy as np

from gaga_core.reconstruct.controls import option
from gaga_core.reconstruct.sfm_bridge import weakest_bridge
from gaga_core.reconstruct.sfm_metrics import MeasureConfig, SfmFacts, SfmSummary

_SHARED = MeasureConfig().shared
_NAMED = 4  # photos named in a sentence


@dataclass(frozen=True)
class CheckConfig:
    """Bounds of the checks: beyond the first a warning, beyond the second an error."""

    registered: tuple[float, float] = (0.8, 0.5)  # share of photos placed
    reprojection: tuple[float, float] = (1.2, 2.5)  # pixels, mean over observations
    track: tuple[float, float] = (3.0, 2.3)  # views, mean over points
    points_per_view: tuple[float, float] = (100, 20)  # observations
    focal_apart: tuple[float, float] = (0.2, 0.5)  # from the prior, as a share of it
    focal_range: tuple[float, float] = (0.5, 0.3)  # least focal length / longest side ...
    focal_long: tuple[float, float] = (3.5, 8.0)  # ... and the greatest
    axes_apart: float = 0.02  # fx against fy, as a share
    parallax: tuple[float, float] = (3.0, 1.0)  # degrees, median over points
    behind: tuple[float, float] = (0.0, 0.01)  # share of observations behind their camera
    agreeing: tuple[float, float] = (0.92, 0.82)  # share of strong pairs that agree with the poses
    doubled: tuple[float, float] = (0.05, 0.12)  # share of matches between two separate points


@dataclass(frozen=True)
class Verdict:
    """One finding: what is odd and what to try."""

    check: str
    level: Literal["warning", "error"]
    text: str


def check_model(
    facts: SfmFacts,
    summary: SfmSummary,
    priors: Mapping[str, float] | None = None,  # focal lengths in pixels by photo, where known
    config: CheckConfig | None = None,
) -> tuple[Verdict, ...]:
    """Everything odd about a model; errors first. An empty tuple: it looks right."""
    config = config or CheckConfig()
    found = [
        *_check_registered(facts, summary, config),
        *_check_contradictions(summary, config),
        *_check_shape(summary, config),
        *_check_focal(facts, priors or {}, config),
    ]
    return tuple(sorted(found, key=lambda verdict: verdict.level != "error"))


def _check_registered(facts: SfmFacts, s: SfmSummary, c: CheckConfig) -> list[Verdict]:
    left = [name for name in facts.all_names if name not in set(facts.names)]
    share = s.registered / max(s.photos, 1)
    found = []
    if left:
        named = ", ".join(left[:_NAMED]) + (" ..." if len(left) > _NAMED else "")
        text = f"{s.registered} of {s.photos} photos were placed; left out: {named}."
        others = [int(n) for n in facts.model_sizes[1:]]
        if share < c.registered[0] and others:
            text += f" {others[0]} of them make a scene of their own."
        level = "error" if share <= c.registered[1] else level_below(share, c.registered)
        if level is None and share < 1:
            level = "warning"
        cure = " Add photos between these and the others, with more than half in common."
        found += _verdict("registered", level, text + cure)
    bridge = weakest_bridge(facts)
    holds = bridge is not None and bridge.holds()
    is_all = holds and s.parts == 2 and bridge is not None and bridge.n_common < _SHARED
    if bridge is not None and not holds:
        found += _verdict(
            "clusters",
            "error",
            f"The placed photos fall into 2 groups, one of {bridge.side.sum()}. The few points "
            "that both see do not tell how the groups lie to each other. Add photos in between, or "
            "reconstruct each group alone.",
        )
    elif s.parts > 1 and not is_all:
        found += _verdict(
            "clusters",
            "error",
            f"The placed photos fall into {s.parts} groups that share too few points to hold each "
            "other. Add photos that see both, or reconstruct each group alone.",
        )
    return found


def _check_contradictions(s: SfmSummary, c: CheckConfig) -> list[Verdict]:
    cure = (
        f"Try {option('--quality', 'full')}, leave out photos that look alike but show another "
        "place, or add "
        "photos in between."
    )
    agree = (
        f"{1 - s.agreeing:.0%} of the photo pairs contradict the model: parts of it are turned or "
        f"moved against each other. {cure}"
    )
    twice = (
        f"{s.doubled:.0%} of the matched details stand in the model twice, at different places: "
        f"walls may be doubled. {cure}"
    )
    behind = f"{s.behind:.1%} of the points lie behind the camera that sees them. {cure}"
    return [
        *_verdict("pairs", level_below(s.agreeing, c.agreeing), agree),
        *_verdict("doubled", _above(s.doubled, c.doubled), twice),
        *_verdict("behind", _above(s.behind, c.behind), behind),
    ]


def _check_shape(s: SfmSummary, c: CheckConfig) -> list[Verdict]:
    per_view = s.points * s.track / max(s.registered, 1)
    return [
        *_verdict(
            "reprojection",
            _above(s.reprojection, c.reprojection),
            f"Points are {s.reprojection:.1f} pixels off in the photos on average. Are there "
            "photos of another lens or zoom, or moving things? Leave them out, or give "
            f"{option('--focal')}.",
        ),
        *_verdict(
            "track",
            level_below(s.track, c.track),
            f"A point is seen in {s.track:.1f} photos on average. Take more photos, in smaller "
            "steps, so that each detail is in at least three.",
        ),
        *_verdict(
            "points",
            level_below(per_view, c.points_per_view),
            f"A photo holds {per_view:.0f} points on average. Sharper photos or "
            f"{option('--quality', 'full')} give more; bare walls and glass give none.",
        ),
        *_verdict(
            "collapse",
            level_below(s.parallax, c.parallax),
            f"The photos see a point under {s.parallax:.1f} degrees at most: the cameras stand "
            "almost at one place for what they see. Walk around the scene; turning on the spot is "
            "not enough.",
        ),
    ]


def _check_focal(facts: SfmFacts, priors: Mapping[str, float], c: CheckConfig) -> list[Verdict]:
    if not len(facts.focal):
        return []
    found = []
    mean = facts.focal.mean(axis=1)
    ratio = mean / facts.sizes.max(axis=1)
    worst = float(ratio[np.abs(np.log(ratio)).argmax()])
    level = level_below(worst, c.focal_range) or _above(worst, c.focal_long)
    found += _verdict(
        "focal",
        level,
        f"The focal length was estimated as {worst:.2f} x the photo's longer side, which few "
        f"lenses have. Give the true one in pixels with {option('--focal')}, or take photos with "
        "EXIF data.",
    )
    apart = float(np.abs(np.log(facts.focal[:, 0] / facts.focal[:, 1])).max())
    if apart > c.axes_apart:
        found += _verdict(
            "axes",
            "warning",
            f"The focal lengths across and down differ by {apart:.0%}, which no camera does. "
            f"Check the result; {option('--focal')} or photos from more heights help.",
        )
    known = [(mean[i], priors[n]) for i, n in enumerate(facts.names) if n in priors]
    if known:
        values = np.array(known)
        off = float(np.abs(values[:, 0] / values[:, 1] - 1).max())
        found += _verdict(
            "prior",
            _above(off, c.focal_apart),
            f"The focal length was estimated {off:.0%} away from what EXIF or --focal says. Check "
            f"{option('--focal')}, or leave out photos that were cropped or zoomed.",
        )
    return found


def _verdict(check: str, level: Literal["warning", "error"] | None, text: str) -> list[Verdict]:
    return [] if level is None else [Verdict(check, level, text)]


def level_below(value: float, bounds: tuple[float, float]) -> Literal["warning", "error"] | None:
    """How bad ``value`` is under the bounds of a warning and of an error; None = fine."""
    if value < bounds[1]:
        return "error"
    return "warning" if value < bounds[0] else None


def _above(value: float, bounds: tuple[float, float]) -> Literal["warning", "error"] | None:
    return level_below(-value, (-bounds[0], -bounds[1]))
