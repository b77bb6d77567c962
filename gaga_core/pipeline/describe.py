"""Words for the groups of a scene that nobody has named, and which of them are background."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np

from gaga_core.camera import Camera
from gaga_core.pipeline.search import train_views
from gaga_core.query.descriptions import describe_groups
from gaga_core.query.group_facts import GroupFacts, facts_of
from gaga_core.scene.objects import object_table
from gaga_core.scene.project import Project
from gaga_core.scene.scene import Scene

_FLAT, _SUPPORT = 0.2, 5.0  # a flat group this many times the median size carries or surrounds


@dataclass(frozen=True)
class Description:
    """What was found out about the groups of a scene."""

    words: Mapping[int, str]  # by group, of those without a name
    background: frozenset[int]  # groups that are what things stand on, hang on, or lie before


def describe(
    scene: Scene,
    facts: GroupFacts,
    cameras: Sequence[Camera] = (),
    kept: Mapping[int, str] | None = None,
) -> Description:
    """Describe the groups of ``scene`` by ``facts`` that were measured of it.

    See `query.descriptions`. Background are what the facts call so, what the association found to
    surround the scene, and large flat groups.
    """
    objects = ~facts.background
    median = float(np.median(facts.size[objects])) if objects.any() else 0.0
    flat = facts.extents[:, 2] < _FLAT * facts.extents[:, 0]
    behind = facts.background | (flat & (facts.size > _SUPPORT * median) & (median > 0))
    levels = None if scene.bank is None else scene.bank.levels
    if levels is not None and levels.background:
        behind = behind | (facts.ids == levels.background)
    return Description(
        describe_groups(scene, replace(facts, background=behind), cameras, kept),
        frozenset(facts.ids[behind & (facts.ids > 0)].tolist()),
    )


def describe_project(project: Project) -> Description:
    """Describe the groups of ``project``; its scene calls them so from then on."""
    cameras = train_views(project)
    found = describe(project.scene, facts_of(project.scene, cameras), cameras)
    project.scene.described = dict(found.words)
    return found


def list_objects(project: Project) -> list[dict[str, object]]:
    """Plain values of each group.

    Id, name, is it a person's, splats, folder, the listed group that it lies under (0 = none), and
    whether it is background.
    """
    if not (project.scene.labels > 0).any():
        return []
    found, table = describe_project(project), object_table(project.scene)
    order, listed = project.scene.folders, frozenset(table.ids.tolist())
    return [
        {
            "group": int(group),
            "name": name,
            "named": int(group) in project.scene.names,
            "splats": int(count),
            "folder": order.places.get(int(group), ""),
            "parent": order.nearest(int(group), listed),
            "background": int(group) in found.background,
        }
        for group, name, count in zip(table.ids, table.names, table.counts, strict=True)
        if group > 0
    ]
