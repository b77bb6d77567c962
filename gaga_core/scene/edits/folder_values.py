"""The edit of the order among objects: folders, and groups under others."""

from collections.abc import Mapping
from dataclasses import dataclass
from typing import TypeVar

from gaga_core.errors import GagaError
from gaga_core.scene.folders import Folders
from gaga_core.scene.scene import Scene

_T = TypeVar("_T")


@dataclass(frozen=True, eq=False)
class SetFolders:
    """Which folders there are, and groups that go into another folder, or under another group."""

    title: str
    before: tuple[str, ...]  # paths
    after: tuple[str, ...]
    # Group, folder before and after; None = in none, or under another group.
    moved: tuple[tuple[int, str | None, str | None], ...]
    # Group, the group that it lies under before and after; None = none.
    parents: tuple[tuple[int, int | None, int | None], ...] = ()

    @property
    def nbytes(self) -> int:
        """Bytes held."""
        paths = sum(len(path) for path in (*self.before, *self.after))
        moved = sum(8 + len(a or "") + len(b or "") for _, a, b in self.moved)
        return paths + moved + 24 * len(self.parents)

    def apply(self, scene: Scene) -> None:
        """Put the groups to their new places."""
        homes = {group: after for group, _, after in self.moved}
        self._write(scene, self.after, homes, {group: after for group, _, after in self.parents})

    def revert(self, scene: Scene) -> None:
        """Put them back."""
        homes = {group: before for group, before, _ in self.moved}
        self._write(scene, self.before, homes, {group: before for group, before, _ in self.parents})

    def _write(
        self,
        scene: Scene,
        paths: tuple[str, ...],
        homes: Mapping[int, str | None],
        parents: Mapping[int, int | None],
    ) -> None:
        now = scene.folders
        try:
            made = Folders(paths, _with(now.home, homes), _with(now.parent, parents))
        except ValueError as error:  # of a recording that was damaged: `Folders` holds its own laws
            raise GagaError(
                f'The step "{self.title}" is damaged ({error}), so it changes nothing. '
                "Go on from here: a new edit takes its place."
            ) from error
        scene.folders = made
        scene.revision.names += 1


def _with(now: Mapping[int, _T], changes: Mapping[int, _T | None]) -> dict[int, _T]:
    """``now`` with other values of some groups; None takes a group out."""
    kept = {group: value for group, value in now.items() if group not in changes}
    kept.update((group, value) for group, value in changes.items() if value is not None)
    return dict(sorted(kept.items()))
