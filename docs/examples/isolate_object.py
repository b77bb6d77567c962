"""Write one object as a file of its own, cleaned: isolate_object.py SCENE GROUP OUT.ply."""

import sys
from pathlib import Path

from gaga_core.export.export import export_scene_stage
from gaga_core.progress import run_stage
from gaga_core.scene import edits
from gaga_core.scene.cleanup import clean_objects_stage, relabel
from gaga_core.scene.edits.history import History
from gaga_core.scene.objects import group_indices
from gaga_core.scene.project import open_path_stage


def main(path: Path, group: int, out: Path) -> None:
    """Clean the object, hide everything else, and export what is visible."""
    scene = run_stage(open_path_stage(path)).scene
    history = History(scene)
    history.do(relabel(scene, run_stage(clean_objects_stage(scene, [group]))))
    history.do(edits.isolate(scene, group_indices(scene, group)))
    written = run_stage(export_scene_stage(scene, out))
    print(f"{out}: {written.n_splats:,} splats")


if __name__ == "__main__":
    main(Path(sys.argv[1]), int(sys.argv[2]), Path(sys.argv[3]))
