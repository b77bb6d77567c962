"""Builders of edits of the state byte: select, hide, isolate, lock, delete."""

from typing import Literal

import numpy as np

from gaga_core.arrays import AnyArray, UInt8Array
from gaga_core.scene.edits.values import FlipState
from gaga_core.scene.index_set import sorted_indices
from gaga_core.scene.scene import Scene, State

How = Literal["set", "add", "remove", "intersect"]
_NOTHING = State(0)


def set_state(
    scene: Scene, indices: AnyArray, on: State, off: State, title: str
) -> FlipState | None:
    """Turn bits ``on`` and ``off`` for these splats."""
    rows = sorted_indices(indices, len(scene))
    old = scene.state[rows]
    changed = np.zeros(len(scene), np.uint8)
    changed[rows] = old ^ ((old | np.uint8(on)) & ~np.uint8(off))
    return FlipState.of(title, changed)


def select(
    scene: Scene, indices: AnyArray, how: How = "set", title: str = "Select"
) -> FlipState | None:
    """Change the selection; deleted and locked splats cannot be selected."""
    chosen = np.zeros(len(scene), np.bool_)
    chosen[sorted_indices(indices, len(scene))] = True
    selected = scene.has(State.SELECTED)
    if how == "set":
        target = chosen
    elif how == "add":
        target = selected | chosen
    elif how == "remove":
        target = selected & ~chosen
    elif how == "intersect":
        target = selected & chosen
    else:
        raise ValueError(f"how: expected set, add, remove or intersect, got {how!r}")
    target = target & ~scene.has(State.DELETED | State.LOCKED)
    changed: UInt8Array = (target != selected).view(np.uint8) * np.uint8(State.SELECTED)
    return FlipState.of(title, changed)


def hide(scene: Scene, indices: AnyArray, title: str = "Hide") -> FlipState | None:
    """Hide splats; what is not seen is not selected either."""
    return set_state(scene, indices, State.HIDDEN, State.SELECTED, title)


def show(scene: Scene, indices: AnyArray, title: str = "Show") -> FlipState | None:
    """Show hidden splats."""
    return set_state(scene, indices, _NOTHING, State.HIDDEN, title)


def show_all(scene: Scene, title: str = "Show all") -> FlipState | None:
    """Show everything that is hidden."""
    return show(scene, scene.has(State.HIDDEN), title)


def isolate(scene: Scene, indices: AnyArray, title: str = "Isolate") -> FlipState | None:
    """Show these splats and hide all others."""
    chosen = np.zeros(len(scene), np.bool_)
    chosen[sorted_indices(indices, len(scene))] = True
    hidden, selected = np.uint8(State.HIDDEN), np.uint8(State.SELECTED)
    old = scene.state
    new = np.where(chosen, old & ~hidden, (old | hidden) & ~selected)
    new = np.where(scene.has(State.DELETED), old, new)
    return FlipState.of(title, old ^ new)


def lock(scene: Scene, indices: AnyArray, title: str = "Lock") -> FlipState | None:
    """Protect splats from being selected."""
    return set_state(scene, indices, State.LOCKED, State.SELECTED, title)


def unlock(scene: Scene, indices: AnyArray, title: str = "Unlock") -> FlipState | None:
    """Let splats be selected again."""
    return set_state(scene, indices, _NOTHING, State.LOCKED, title)


def delete(scene: Scene, indices: AnyArray, title: str = "Delete") -> FlipState | None:
    """Delete splats (a bit: rows stay until export)."""
    return set_state(scene, indices, State.DELETED, State.SELECTED, title)


def restore(scene: Scene, title: str = "Restore deleted") -> FlipState | None:
    """Bring back everything that was deleted."""
    return set_state(scene, scene.has(State.DELETED), _NOTHING, State.DELETED, title)
