"""Edits of the scene as a whole: move it, say how long it is, put its origin somewhere."""

from dataclasses import dataclass

import numpy as np

from gaga_core.arrays import AnyArray, DoubleArray
from gaga_core.errors import GagaError
from gaga_core.scene.edits.placement import transform
from gaga_core.scene.edits.values import Edit, together
from gaga_core.scene.frame import Frame, scale_of
from gaga_core.scene.scene import Scene
from gaga_core.scene.selection import algebra

_LEAST, _MOST = 1e-9, 1e9  # factors of a scale


@dataclass(frozen=True, eq=False)
class SetFrame:
    """How the whole scene was moved (frozen values)."""

    title: str
    before: Frame
    after: Frame

    @property
    def nbytes(self) -> int:
        """Bytes held."""
        return int(self.before.world.nbytes + self.after.world.nbytes)

    def apply(self, scene: Scene) -> None:
        """Put the new value in place."""
        scene.frame = self.after
        scene.revision.placements += 1

    def revert(self, scene: Scene) -> None:
        """Put the old value back."""
        scene.frame = self.before
        scene.revision.placements += 1


def move_scene(
    scene: Scene, matrix: AnyArray, title: str, *, is_metric: bool | None = None
) -> Edit | None:
    """Move everything, hidden and locked splats too, by a similarity (3, 4), world.

    Photos, bookmarks and the camera path follow (`gaga_core.scene.frame`). ``is_metric`` says
    whether a unit is a metre then; by default as before. Raises ``ValueError`` when the map is no
    rotation times a scale.
    """
    motion = np.vstack([np.asarray(matrix, np.float64)[:3], [0.0, 0.0, 0.0, 1.0]])
    scale_of(motion)
    before = scene.frame
    metric = before.is_metric if is_metric is None else is_metric
    after = Frame(motion @ before.world, metric)
    set_frame = None if after.equals(before) else SetFrame(title, before, after)
    is_still = np.array_equal(motion, np.eye(4))
    moved = None if is_still else transform(scene, algebra.whole(scene), motion[:3], title)
    return together(title, [moved, set_frame])


def set_scale(scene: Scene, length: float, metres: float, about: AnyArray) -> Edit | None:
    """Scale everything about a point (3,) so that ``length``, world, becomes ``metres``.

    A unit is a metre then. Raises ``GagaError`` when a length is no positive number, or the factor
    is none that a scene can have.
    """
    if not (np.isfinite([length, metres]).all() and length > 0 and metres > 0):
        raise GagaError("A length must be above 0.")
    factor = metres / length
    if not _LEAST < factor < _MOST:
        raise GagaError(f"The scene would become {factor:.3g} times as large. Check the lengths.")
    return move_scene(scene, _about(factor, about), "Set scale", is_metric=True)


def set_origin(scene: Scene, point: AnyArray) -> Edit | None:
    """Move everything so that a point (3,), world, becomes the origin."""
    offset = -np.asarray(point, np.float64)
    return move_scene(scene, np.column_stack([np.eye(3), offset]), "Set origin")


def _about(factor: float, point: AnyArray) -> DoubleArray:
    """The map (3, 4) that scales about a point (3,)."""
    centre = np.asarray(point, np.float64)
    return np.column_stack([factor * np.eye(3), (1 - factor) * centre])
