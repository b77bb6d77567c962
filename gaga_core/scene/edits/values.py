"""What an undo entry is made of: edits as values, each with its exact inverse.

Columns of a scene are replaced, never written in place: a worker thread or an export that holds a
shallow copy of the scene (``dataclasses.replace(scene)``) keeps a consistent snapshot for free. It
also means that an edit that fails half-way has changed nothing.
"""

from collections.abc import Iterable
from dataclasses import dataclass
from typing import Protocol

import numpy as np

from gaga_core.arrays import UInt8Array
from gaga_core.grouping.memory_bank import MemoryBank
from gaga_core.scene.index_set import IndexSet, PackedInts
from gaga_core.scene.scene import RGB, Identities, Scene, State


class Edit(Protocol):
    """A change of a scene and its inverse. ``revert`` after ``apply`` restores every bit."""

    @property
    def title(self) -> str:
        """What the user did: "Recolor"."""
        ...

    @property
    def nbytes(self) -> int:
        """Bytes that this edit holds."""
        ...

    def apply(self, scene: Scene) -> None:
        """Make the change; on an exception the scene is as before."""
        ...

    def revert(self, scene: Scene) -> None:
        """Take the change back."""
        ...


@dataclass(frozen=True, eq=False)
class Edits:
    """Several edits as one: applied in order, reverted in reverse."""

    title: str
    edits: tuple[Edit, ...]

    @property
    def nbytes(self) -> int:
        """Bytes held."""
        return sum(edit.nbytes for edit in self.edits)

    def apply(self, scene: Scene) -> None:
        """Apply all, or none when one fails."""
        done: list[Edit] = []
        try:
            for edit in self.edits:
                edit.apply(scene)
                done.append(edit)
        except BaseException:
            for edit in reversed(done):
                edit.revert(scene)
            raise

    def revert(self, scene: Scene) -> None:
        """Revert all, last first."""
        for edit in reversed(self.edits):
            edit.revert(scene)


def together(title: str, edits: Iterable[Edit | None]) -> Edit | None:
    """One edit of those that change something; None when none does."""
    real = tuple(edit for edit in edits if edit is not None)
    return Edits(title, real) if real else None


def is_selection(edit: Edit) -> bool:
    """Whether an edit changes what is selected and nothing else."""
    if isinstance(edit, Edits):
        return all(is_selection(part) for part in edit.edits)
    return isinstance(edit, FlipState) and all(bits == State.SELECTED for bits, _ in edit.flips)


@dataclass(frozen=True, eq=False)
class FlipState:
    """State bits that flip, and on which splats; its own inverse."""

    title: str
    n: int  # splats of the scene
    flips: tuple[tuple[int, IndexSet], ...]

    @staticmethod
    def of(title: str, changed: UInt8Array) -> "FlipState | None":
        """The edit that flips the bits ``changed`` (N,) of each splat; None when all are 0."""
        kinds = np.flatnonzero(np.bincount(changed, minlength=256)[1:]) + 1
        n = len(changed)
        flips = [(int(k), IndexSet.of(np.flatnonzero(changed == k), n)) for k in kinds]
        return FlipState(title, n, tuple(flips)) if flips else None

    @property
    def nbytes(self) -> int:
        """Bytes held."""
        return sum(splats.nbytes for _, splats in self.flips)

    def apply(self, scene: Scene) -> None:
        """Flip the bits."""
        check_length(scene, self.n)
        state = scene.state.copy()
        for bits, splats in self.flips:
            if splats.count > self.n // 16:
                state ^= splats.mask().view(np.uint8) * np.uint8(bits)
            else:
                state[splats.indices()] ^= np.uint8(bits)
        scene.state = state
        scene.revision.state += 1

    def revert(self, scene: Scene) -> None:
        """Flip them back."""
        self.apply(scene)


@dataclass(frozen=True, eq=False)
class SetLabels:
    """Group ids of some splats."""

    title: str
    splats: IndexSet
    before: PackedInts
    after: PackedInts

    @property
    def nbytes(self) -> int:
        """Bytes held."""
        return self.splats.nbytes + self.before.nbytes + self.after.nbytes

    def apply(self, scene: Scene) -> None:
        """Write the new ids."""
        self._write(scene, self.after)

    def revert(self, scene: Scene) -> None:
        """Write the old ids."""
        self._write(scene, self.before)

    def _write(self, scene: Scene, values: PackedInts) -> None:
        check_length(scene, self.splats.n)
        labels = scene.labels.copy()
        labels[self.splats.indices()] = values.data
        scene.labels = labels
        scene.revision.labels += 1


@dataclass(frozen=True, eq=False)
class SetNames:
    """Names of groups; None = the group has no name of its own."""

    title: str
    before: tuple[tuple[int, str | None], ...]
    after: tuple[tuple[int, str | None], ...]

    @property
    def nbytes(self) -> int:
        """Bytes held."""
        return sum(8 + len(name or "") for _, name in self.before + self.after)

    def apply(self, scene: Scene) -> None:
        """Give the new names."""
        self._write(scene, self.after)

    def revert(self, scene: Scene) -> None:
        """Give the old names."""
        self._write(scene, self.before)

    def _write(self, scene: Scene, names: tuple[tuple[int, str | None], ...]) -> None:
        changed = dict(names)
        kept = {g: name for g, name in scene.names.items() if g not in changed}
        kept.update((g, name) for g, name in names if name is not None)
        scene.names = dict(sorted(kept.items()))
        scene.revision.names += 1


@dataclass(frozen=True, eq=False)
class SetColor:
    """A group's color in lists and in the group render mode; None = the palette's."""

    title: str
    group: int
    before: RGB | None
    after: RGB | None

    @property
    def nbytes(self) -> int:
        """Bytes held."""
        return 56

    def apply(self, scene: Scene) -> None:
        """Give the new color."""
        self._write(scene, self.after)

    def revert(self, scene: Scene) -> None:
        """Give the old color."""
        self._write(scene, self.before)

    def _write(self, scene: Scene, color: RGB | None) -> None:
        kept = {group: rgb for group, rgb in scene.colors.items() if group != self.group}
        if color is not None:
            kept[self.group] = color
        scene.colors = dict(sorted(kept.items()))
        scene.revision.names += 1


@dataclass(frozen=True, eq=False)
class SetBank:
    """The memory bank (a frozen value) whose log explains the labels."""

    title: str
    before: MemoryBank | None
    after: MemoryBank | None

    @property
    def nbytes(self) -> int:
        """Bytes held: group ids, and about 100 bytes a decision."""
        banks = (self.before, self.after)
        return sum(bank.group.nbytes + 100 * len(bank.log) for bank in banks if bank is not None)

    def apply(self, scene: Scene) -> None:
        """Put the new bank in place."""
        scene.bank = self.after
        scene.revision.labels += 1

    def revert(self, scene: Scene) -> None:
        """Put the old bank back."""
        scene.bank = self.before
        scene.revision.labels += 1


@dataclass(frozen=True, eq=False)
class SetConfidence:
    """How sure the splats are of their groups (a frozen column, by row of the opened file)."""

    title: str
    before: UInt8Array | None
    after: UInt8Array | None

    @property
    def nbytes(self) -> int:
        """Bytes held."""
        return sum(column.nbytes for column in (self.before, self.after) if column is not None)

    def apply(self, scene: Scene) -> None:
        """Put the new column in place."""
        scene.confidence = self.after
        scene.revision.labels += 1

    def revert(self, scene: Scene) -> None:
        """Put the old column back."""
        scene.confidence = self.before
        scene.revision.labels += 1


@dataclass(frozen=True, eq=False)
class SetIdentities:
    """Where labels come from, and those of the other source (frozen values)."""

    title: str
    before: Identities
    after: Identities

    @property
    def nbytes(self) -> int:
        """Bytes held."""
        return self.before.nbytes + self.after.nbytes

    def apply(self, scene: Scene) -> None:
        """Put the new value in place."""
        scene.identities = self.after
        scene.revision.labels += 1

    def revert(self, scene: Scene) -> None:
        """Put the old value back."""
        scene.identities = self.before
        scene.revision.labels += 1


@dataclass(frozen=True, eq=False)
class SetNamedSelection:
    """A named selection; None = there is none of that name."""

    title: str
    name: str
    before: IndexSet | None
    after: IndexSet | None

    @property
    def nbytes(self) -> int:
        """Bytes held."""
        return sum(kept.nbytes for kept in (self.before, self.after) if kept is not None)

    def apply(self, scene: Scene) -> None:
        """Keep the new set."""
        self._write(scene, self.after)

    def revert(self, scene: Scene) -> None:
        """Keep the old set."""
        self._write(scene, self.before)

    def _write(self, scene: Scene, kept: IndexSet | None) -> None:
        sets = {
            name: splats for name, splats in scene.named_selections.items() if name != self.name
        }
        if kept is not None:
            sets[self.name] = kept
        scene.named_selections = dict(sorted(sets.items()))
        scene.revision.names += 1


def check_length(scene: Scene, n: int) -> None:
    """Raise ``ValueError`` when an edit was made for a scene of another length."""
    if len(scene) != n:
        raise ValueError(f"edit of {n} splats applied to a scene of {len(scene)}")
