"""Write one object as a file of its own, cleaned: isolate_object.py SCENE NAME-OR-ID OUT.ply."""

import sys

import gaga_core


def main(path: str, name: str, out: str) -> None:
    """Clean the object and export it alone."""
    objects = gaga_core.open(path).objects
    thing = objects[int(name) if name.isdecimal() else name]
    thing.clean()
    print(f"{thing.export(out)}: {len(thing):,} splats")


if __name__ == "__main__":
    main(sys.argv[1], sys.argv[2], sys.argv[3])
