"""Print the objects of a scene with their sizes: list_objects.py SCENE."""

import sys

import gaga_core


def main(path: str) -> None:
    """List every object: id, name, number of splats."""
    for group, thing in gaga_core.open(path).objects.items():
        print(f"{group:5d}  {len(thing):9,d}  {thing.name}")


if __name__ == "__main__":
    main(sys.argv[1])
