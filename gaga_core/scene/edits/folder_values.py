"""The edit of folders of the object list."""

from dataclasses import dataclass

from gaga_core.scene.folders import Folders
from gaga_core.scene.scene import Scene


@dataclass(frozen=True, eq=False)
class SetFolders:
    """Which folders there are, and groups that go from one to another; None = in none."""

    title: str
    before: tuple[str, ...]  # paths
    after: tuple[str, ...]
    moved: tuple[tuple[int, str | None, str | None], ...]  # group, folder before and after

    @property
    def nbytes(self) -> int:
        """Bytes held."""
        paths = sum(len(path) for path in (*self.before, *self.after))
        return paths + sum(8 + len(a or "") + len(b or "") for _, a, b in self.moved)

    def apply(self, scene: Scene) -> None:
        """Put the groups into their new folders."""
        self._write(scene, self.after, {group: after for group, _, after in self.moved})

    def revert(self, scene: Scene) -> None:
        """Put them back."""
        self._write(scene, self.before, {group: before for group, before, _ in self.moved})

    def _write(self, scene: Scene, paths: tuple[str, ...], homes: dict[int, str | None]) -> None:
        kept = {group: path for group, path in scene.folders.home.items() if group not in homes}
        kept.update((group, path) for group, path in homes.items() if path is not None)
        scene.folders = Folders(paths, dict(sorted(kept.items())))
        scene.revision.names += 1
