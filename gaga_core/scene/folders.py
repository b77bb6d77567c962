"""Folders of the object list: a tree of names, and in which folder each group is.

A folder is known by its path, "Kitchen/Cups": it lies in the folder "Kitchen". Names of folders in
the same folder differ, so that a path means one folder.
"""

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, field
from itertools import count, islice

from gaga_core.errors import GagaError

SEPARATOR = "/"
MOST_LETTERS = 200  # of a name
MOST_DEPTH = 32  # folders that lie in each other


@dataclass(frozen=True)
class Folders:
    """All folders of a scene. Raises ``ValueError`` when they do not fit each other."""

    paths: tuple[str, ...] = ()  # ascending; those that a folder lies in are there, too
    home: Mapping[int, str] = field(default_factory=dict)  # folder of each group that is in one

    def __post_init__(self) -> None:
        known = set(self.paths)
        if list(self.paths) != sorted(known):
            raise ValueError("paths: expected ascending paths that differ")
        for path in self.paths:
            if not all(path.split(SEPARATOR)) or (parent_of(path) and parent_of(path) not in known):
                raise ValueError(f"paths: {path!r} lies in no folder")
        if not known.issuperset(self.home.values()):
            raise ValueError("home: a folder that is not there")

    @staticmethod
    def of(paths: Iterable[str], home: Mapping[int, str]) -> "Folders":
        """The folders of any paths: those that they lie in, and those of groups, are added."""
        wanted = {tidy_path(path) for path in paths}
        tidy = {group: tidy_path(path) for group, path in home.items()}
        wanted.update(tidy.values())
        found = {above for path in wanted for above in (path, *parents_of(path))} - {""}
        inside = {group: path for group, path in sorted(tidy.items()) if path}
        return Folders(tuple(sorted(found)), inside)

    def tree(self, path: str) -> tuple[str, ...]:
        """A folder and all that lie in it; of "" all folders."""
        return tuple(p for p in self.paths if not path or is_inside(p, path))

    def groups(self, path: str) -> tuple[int, ...]:
        """Groups in a folder and in all that lie in it, ascending."""
        return tuple(sorted(g for g, home in self.home.items() if is_inside(home, path)))

    def free(self, parent: str, name: str) -> str:
        """The path of a new folder: "Cups", or "Cups 2" where that is taken."""
        taken = set(self.paths)
        ends = ("" if i == 1 else f" {i}" for i in count(1))
        names = (name[: MOST_LETTERS - len(end)].rstrip() + end for end in ends)
        return next(path for path in (path_of(parent, n) for n in names) if path not in taken)


def path_of(parent: str, name: str) -> str:
    """The path of a folder in ``parent``; "" is the top."""
    return f"{parent}{SEPARATOR}{name}" if parent else name


def parent_of(path: str) -> str:
    """The folder that a folder lies in; "" is the top."""
    return path.rpartition(SEPARATOR)[0]


def parents_of(path: str) -> Sequence[str]:
    """All folders that a folder lies in, the nearest first, without the top."""
    parts = path.split(SEPARATOR)
    return [SEPARATOR.join(parts[:n]) for n in range(len(parts) - 1, 0, -1)]


def name_of(path: str) -> str:
    """The last name of a path."""
    return path.rpartition(SEPARATOR)[2]


def is_inside(path: str, folder: str) -> bool:
    """Whether ``path`` is ``folder`` or lies in it."""
    return path == folder or path.startswith(folder + SEPARATOR)


def tidy_path(path: str) -> str:
    """A path without needless spaces and empty names, and not too long."""
    names = (" ".join(name.split())[:MOST_LETTERS].strip() for name in path.split(SEPARATOR))
    return SEPARATOR.join(islice((name for name in names if name), MOST_DEPTH))


def checked_name(name: str) -> str:
    """A name for a folder; ``GagaError`` when it is empty or has a "/" in it."""
    tidy = " ".join(name.split())[:MOST_LETTERS].strip()
    if not tidy:
        raise GagaError("A folder needs a name.")
    if SEPARATOR in tidy:
        raise GagaError(f'The name of a folder has no "{SEPARATOR}". Choose another one.')
    return tidy
