"""What tests of the session look at."""

from gaga_core.arrays import IntArray
from gaga_core.scene.scene import Scene
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


def true_labels() -> IntArray:
    return objects_scene(5, 220, n_cameras=8).labels
