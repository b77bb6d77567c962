"""Order among objects: a tree of folders, the folder of each group, and groups under others.

A folder is known by its path, "Kitchen/Cups": it lies in the folder "Kitchen". Names of folders in
the same folder differ, so that a path means one folder. A group can lie under another one, as a lid
under its teapot; then it is where that one is.
"""

from collections.abc import Collection, Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field
from functools import cached_property
from itertools import count, islice

from gaga_core.errors import GagaError

SEPARATOR = "/"
MOST_LETTERS = 200  # of a name
MOST_DEPTH = 32  # levels of nested folders


@dataclass(frozen=True)
class Folders:
    """All folders of a scene and what is in them.

    Raises ``ValueError`` when they do not fit each other, or a group lies under itself.
    """

    paths: tuple[str, ...] = ()  # ascending; those that a folder lies in are there, too
    # Folder of each group that is in one and under no other group; see `places`.
    home: Mapping[int, str] = field(default_factory=dict)
    parent: Mapping[int, int] = field(default_factory=dict)  # group that a group lies under

    def __post_init__(self) -> None:
        known = set(self.paths)
        if list(self.paths) != sorted(known):
            raise ValueError("paths: expected ascending paths that differ")
        for path in self.paths:
            if not all(path.split(SEPARATOR)) or (parent_of(path) and parent_of(path) not in known):
                raise ValueError(f"paths: {path!r} lies in no folder")
        if not known.issuperset(self.home.values()):
            raise ValueError("home: a folder that is not there")
        if min((*self.parent, *self.parent.values()), default=1) <= 0:
            raise ValueError("parent: expected ids > 0")
        if not self.home.keys().isdisjoint(self.parent):
            raise ValueError("home: a group that lies under another one has no folder of its own")
        _ = self.top  # raises for groups that lie under themselves

    @staticmethod
    def of(
        paths: Iterable[str], home: Mapping[int, str], parent: Mapping[int, int] | None = None
    ) -> "Folders":
        """The folders of any paths: those that they lie in, and those of groups, are added.

        Of a group with a parent, ``home`` says nothing. Raises ``ValueError`` as the class does.
        """
        under = dict(sorted((parent or {}).items()))
        wanted = {tidy_path(path) for path in paths}
        tidy = {g: tidy_path(path) for g, path in sorted(home.items()) if g not in under}
        wanted.update(tidy.values())
        found = {above for path in wanted for above in (path, *parents_of(path))} - {""}
        inside = {group: path for group, path in tidy.items() if path}
        return Folders(tuple(sorted(found)), inside, under)

    # --- groups under others

    @cached_property
    def top(self) -> Mapping[int, int]:
        """The topmost group above each group that lies under another one."""
        tops: dict[int, int] = {}
        for child in self.parent:
            way, group = [], child
            while group in self.parent and group not in tops:
                way.append(group)
                group = self.parent[group]
                if len(way) > len(self.parent):
                    raise ValueError(f"parent: group {child} lies under itself")
            tops.update(dict.fromkeys(way, tops.get(group, group)))
        return tops

    @cached_property
    def places(self) -> Mapping[int, str]:
        """Folder of each group that is in one, itself or with the group that it lies under."""
        found = {group: self.home.get(top, "") for group, top in self.top.items()}
        return {**self.home, **{group: path for group, path in found.items() if path}}

    @cached_property
    def children(self) -> Mapping[int, tuple[int, ...]]:
        """The groups right under each group that has some, ascending."""
        found: dict[int, list[int]] = {}
        for group, parent in sorted(self.parent.items()):
            found.setdefault(parent, []).append(group)
        return {group: tuple(below) for group, below in found.items()}

    def above(self, group: int) -> Iterator[int]:
        """The groups that a group lies under, the nearest first."""
        while group in self.parent:
            group = self.parent[group]
            yield group

    def under(self, *groups: int) -> tuple[int, ...]:
        """All groups that lie under these, at any depth, ascending; without these."""
        found: set[int] = set()
        left = list(groups)
        while left:
            below = self.children.get(left.pop(), ())
            left += [group for group in below if group not in found]
            found.update(below)
        return tuple(sorted(found.difference(groups)))

    def tops_of(self, groups: Collection[int]) -> list[int]:
        """Those of ``groups`` that lie under none of the others, each once."""
        among = set(groups)
        return [g for g in dict.fromkeys(groups) if among.isdisjoint(self.above(g))]

    def nearest(self, group: int, among: Collection[object]) -> int:
        """The nearest group of ``among`` that a group lies under; 0 = none."""
        return next((above for above in self.above(group) if above in among), 0)

    def renumbered(self, ids: Mapping[int, int]) -> "Folders":
        """The same for groups (keys) whose ids are others now (values, no two the same).

        Groups that are no keys are left out: what lies under one goes where that was.
        """
        parent = {new: ids[a] for g, new in ids.items() if (a := self.nearest(g, ids))}
        places = {new: self.places.get(group, "") for group, new in ids.items()}
        return Folders.of(self.paths, places, parent)

    # --- folders

    def tree(self, path: str) -> tuple[str, ...]:
        """A folder and all that lie in it; of "" all folders."""
        return tuple(p for p in self.paths if not path or is_inside(p, path))

    def groups(self, path: str) -> tuple[int, ...]:
        """Groups in a folder, in all that lie in it, and under those; ascending."""
        return tuple(sorted(g for g, place in self.places.items() if is_inside(place, path)))

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
