"""Under which conditions a scene was scored, and where they are not those of the paper.

A figure next to a published one says that both were measured the same way. Where that is not so,
`departures` names it, and the tables print the published figures apart.
"""

import re
from collections.abc import Sequence
from dataclasses import dataclass

from gaga_core.evaluate.published import PROTOCOLS, SAM_PROMPTS
from gaga_core.io.datasets.catalog import DATASETS

MADE_ELSEWHERE = "made elsewhere"  # in the place of a model: masks without a record of it
PUBLISHED_RULE = "boxes of a detector, masks of SAM in them"  # how prompts were answered


@dataclass(frozen=True)
class Conditions:
    """How one scene was scored."""

    split: str = ""  # rule that parted the views
    n_train: int = 0
    n_test: int = 0  # of them scored: those with a truth
    truth: str = ""
    masks: str = ""  # folder of the 2D masks, and who made them; "" where predictions are given
    splats: str = ""  # where they are from; "" likewise
    queries: str = ""  # how text prompts were answered; "" without prompts


def departures(dataset: str, scene: str, of: Conditions) -> tuple[str, ...]:
    """What is not as published, one phrase a thing; none for a data set that nobody published."""
    published = PROTOCOLS.get(dataset)
    if published is None:
        return ()
    found = []
    if of.split not in published.splits:
        found.append(f"split of {scene}: {of.split}")
    if of.truth not in published.truths:
        found.append(f"truth of {scene}: {of.truth}, not {' or '.join(published.truths)}")
    if of.masks and not _are_of(published.masks, of.masks):
        found.append(f"masks of {scene}: {of.masks}, not SAM ViT-H's or EntitySeg's")
    elif "points a side" in of.masks and SAM_PROMPTS not in of.masks:
        found.append(f"masks of {scene}: {of.masks}, not {SAM_PROMPTS}")
    if published.queries and of.queries and not of.queries.startswith(PUBLISHED_RULE):
        found.append(f"queries: {of.queries}, not {PUBLISHED_RULE}")
    return tuple(found)


def _are_of(segmenters: Sequence[str], masks: str) -> bool:
    """Whether one of ``segmenters`` made ``masks``, "folder (model)", as far as that is said.

    Where the model is not known, the name of the folder decides. A name counts as a whole word, and
    SAM 2, SAM 3, SAM-HQ and SAM with a smaller encoder than ViT-H are other models.
    """
    folder, _, model = masks.removesuffix(")").partition(" (")
    name = folder if model in ("", MADE_ELSEWHERE) else model
    words = "|".join(map(re.escape, segmenters))
    found = re.search(rf"(?i)(?<![a-z0-9])({words})(?![a-z0-9]|[ _-]*(hq|\d))", name)
    return bool(found) and not re.search(r"(?i)vit[ _-]*[bl](?![a-z0-9])", name)


def absent_scenes(dataset: str, scenes: Sequence[str]) -> tuple[str, ...]:
    """The published scenes of a data set that are not among ``scenes``."""
    return tuple(name for name in DATASETS[dataset].scenes if name not in scenes)


def sentences(dataset: str, scenes: Sequence[tuple[str, Conditions]]) -> list[str]:
    """What every table of a data set says about how it was made."""
    if not scenes:
        return []
    found = []
    for title, name in (("Split", "split"), ("Truth", "truth"), ("Masks", "masks")):
        found += _each(title, [(scene, str(getattr(of, name))) for scene, of in scenes])
    known = DATASETS[dataset].scenes
    names = [scene for scene, _ in scenes]
    absent = absent_scenes(dataset, names)
    if known:
        text = f"Scenes: {len(known) - len(absent)} of the {len(known)} of the data set"
        more = [name for name in names if name not in known]
        without = f", without {', '.join(absent)}" if absent else ""
        found.append(f"{text}{without}{', and ' + ', '.join(more) if more else ''}.")
    found += _each("Splats", [(scene, of.splats) for scene, of in scenes])
    found += _each("Queries", [(scene, of.queries) for scene, of in scenes])
    return found


def _each(title: str, values: Sequence[tuple[str, str]]) -> list[str]:
    """One sentence, or one for each group of scenes that differ."""
    distinct = list(dict.fromkeys(value for _, value in values if value))
    if len(distinct) == 1 and all(value for _, value in values):
        return [f"{title}: {distinct[0]}."]
    return [
        f"{title}: {value} ({', '.join(scene for scene, own in values if own == value)})."
        for value in distinct
    ]
