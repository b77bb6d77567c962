"""What tests of the session look at."""

import time

from gaga_core.arrays import IntArray
from gaga_core.pipeline.search import train_views
from gaga_core.scene.scene import Scene
from gaga_studio.features.find import search
from gaga_studio.features.find.search import SearchState
from gaga_studio.session.notices import Level
from gaga_studio.session.session import Session
from tests.scenes import objects_scene


def snapshot(scene: Scene) -> list[bytes]:
    columns = (
        scene.gaussians.means,
        scene.labels,
        scene.state,
        scene.placement,
        scene.source,
        scene.placements.matrix,
        scene.placements.color,
        scene.placements.opacity,
    )
    return [c.tobytes() for c in columns] + [repr(sorted(scene.names.items())).encode()]


def objects_of(session: Session) -> list[int]:
    return [int(g) for g in session.objects().ids if g > 0]


def scene_of(session: Session) -> Scene:
    assert session.scene is not None
    return session.scene


def finish(session: Session) -> None:
    assert session.jobs.wait()
    errors = [n.text for n in session.notices if n.level is Level.ERROR]
    assert errors == []


def describe(session: Session) -> dict[int, str]:
    """What objects are called once all is measured, as every frame does; by id."""
    document, end = session.need(), time.monotonic() + 60
    state = document.feature(SearchState)
    while True:
        search.follow(session)
        session.jobs.poll()
        key = state.key(document.scene, train_views(document.project))
        if state.measured is not None and state.measured.key == key and not session.jobs.quiet:
            search.follow(session)
            return names_of(session)
        assert time.monotonic() < end
        time.sleep(0.02)


def names_of(session: Session) -> dict[int, str]:
    """What objects are called now, by id."""
    table = session.objects()
    return dict(zip(table.ids.tolist(), table.names, strict=True))


def true_labels() -> IntArray:
    return objects_scene(5, 220, n_cameras=8).labels
