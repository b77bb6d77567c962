"""What the report says of a placement: photos that are in or out and why, and their links."""

from collections.abc import Mapping
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Annotated

import msgspec
import numpy as np

from gaga_core.reconstruct.controls import option
from gaga_core.reconstruct.photos import PhotoSet
from gaga_core.reconstruct.sfm_ladder import Ladder
from gaga_core.reconstruct.sfm_metrics import SfmFacts

_LINKED = 15  # verified matches that link two photos
_MOST_LINKS = 3000  # in the report, the strongest


_Index = Annotated[int, msgspec.Meta(ge=0)]


class _Placement(msgspec.Struct, frozen=True):
    """What is read again of the entry "sfm" of a report."""

    names: list[str]
    why_out: dict[str, str]
    links: list[tuple[_Index, _Index, _Index]]  # photo, photo, verified matches


class _Check(msgspec.Struct, frozen=True):
    """A verdict of the checks."""

    text: str


class _Remarks(msgspec.Struct, frozen=True):
    """What a person should know, in the same entry."""

    notes: list[str] = []
    checks: list[_Check] = []


@dataclass(frozen=True)
class PlacementReport:
    """A placement as the window shows it. A photos."""

    names: tuple[str, ...]  # (A,) every photo, by name
    left_out: Mapping[str, str]  # names of those without a place, and why
    links: tuple[tuple[int, int, int], ...]  # photo, photo, verified matches

    @property
    def n_placed(self) -> int:
        """Photos that have a place."""
        return len(self.names) - len(self.left_out)


def placement_of(entry: Mapping[str, object]) -> PlacementReport | None:
    """The placement in the entry "reconstruct" of a report; None where there is none in it."""
    try:
        sfm = msgspec.convert(entry.get("sfm"), _Placement)
    except ValueError:  # none, of an older version, or damaged
        return None
    known = set(sfm.names)
    out = {name: why for name, why in sfm.why_out.items() if name in known}
    inside = [link for link in sfm.links if max(link[:2]) < len(sfm.names)]
    return PlacementReport(tuple(sfm.names), out, tuple(inside))


def sfm_entry(source: Path, photos: PhotoSet, made: Ladder) -> dict[str, object]:
    """The entry "sfm" of the report: figures, checks, attempts, and the graph of the pairs."""
    best = made.best
    placed = set(best.facts.names)
    left_out = [photo.name for photo in photos.photos if photo.name not in placed]
    return best.summary.to_json() | {
        "source": str(source),
        "left_out": left_out,
        "why_out": {name: made.diagnosis.why_out(name, made.best.placed) for name in left_out},
        "names": list(best.facts.all_names),
        "links": _links(best.facts),
        "notes": [*photos.notes, *_scene_notes(made, placed), *made.reasons()],
        "checks": [asdict(verdict) for verdict in best.verdicts],
        "attempts": list(made.attempts),
        "scenes": [list(names) for names in best.scenes],
        "blurred": list(made.diagnosis.blurred),
    }


def _links(facts: SfmFacts) -> list[list[int]]:
    """The strongest links (photo, photo, matches), indices into ``facts.all_names``."""
    order = np.argsort(-facts.pair_matches, kind="stable")[:_MOST_LINKS]
    chosen = order[facts.pair_matches[order] >= _LINKED]
    rows = np.c_[facts.pairs[chosen], facts.pair_matches[chosen]]
    found: list[list[int]] = rows.tolist()
    return found


def notes_of(entry: Mapping[str, object]) -> tuple[str, ...]:
    """What a person should know of the entry "sfm" of a report: left out photos, warnings."""
    try:
        remarks = msgspec.convert(entry, _Remarks)
    except ValueError:  # damaged: nothing is known
        return ()
    return (*remarks.notes, *(check.text for check in remarks.checks))


def _scene_notes(made: Ladder, placed: set[str]) -> list[str]:
    """Which photos show other scenes, and how to get those."""
    found = []
    for i, names in enumerate(made.best.scenes, start=1):
        if not placed & set(names):
            listed = ", ".join(names[:3]) + (" ..." if len(names) > 3 else "")
            found.append(
                f"{len(names)} photos show another scene, which is not in this one: {listed}. "
                f"{option('--scene', str(i))} with another scene folder makes it. If it is the "
                "same place, add photos in between."
            )
    return found
