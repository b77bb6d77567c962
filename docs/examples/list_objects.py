"""Print the objects of a scene with their sizes: list_objects.py SCENE."""

import sys
from pathlib import Path

from gaga_core.progress import run_stage
from gaga_core.scene.objects import group_name, object_table
from gaga_core.scene.project import open_path_stage


def main(path: Path) -> None:
    """List every object: id, name, number of splats."""
    scene = run_stage(open_path_stage(path)).scene
    table = object_table(scene)
    for group, n_splats in zip(table.ids.tolist(), table.counts.tolist(), strict=True):
        print(f"{group:5d}  {n_splats:9,d}  {group_name(scene, group)}")


if __name__ == "__main__":
    main(Path(sys.argv[1]))
