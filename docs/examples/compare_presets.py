"""Associate the masks of a scene with both presets: compare_presets.py SCENE.

Nothing is written: the stage of the library is run, not that of the scene folder.
"""

import sys
from pathlib import Path

from gaga_core.grouping.associate import PRESETS, AssociateConfig, associate_stage
from gaga_core.io.folder.scene_folder import mask_path_of, open_scene_folder, select_views
from gaga_core.io.masks.label_maps import mask_folder
from gaga_core.io.splats.splat_files import read_splats
from gaga_core.progress import run_stage
from gaga_core.raster import choose


def main(path: Path) -> None:
    """Print groups and labelled Gaussians of each preset."""
    folder = open_scene_folder(path)
    if folder.model_path is None:
        sys.exit(f"There are no splats in {path}.")
    gaussians = read_splats(folder.model_path)
    cameras = select_views(folder, "train")
    masks = mask_folder(mask_path_of(folder, None), [camera.name for camera in cameras])
    for preset in PRESETS:
        config = AssociateConfig.of(preset)
        found = run_stage(associate_stage(gaussians, cameras, masks, choose(), config)).to_json()
        print(f"{preset:8s} {found['groups']} groups, {found['labelled']} Gaussians labelled")


if __name__ == "__main__":
    main(Path(sys.argv[1]))
