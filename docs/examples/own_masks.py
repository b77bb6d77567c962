"""Associate label maps that you made yourself: own_masks.py SCENE.

The maps of this example are the areas of similar brightness. Put your segmenter into `my_masks`.
"""

import sys
from pathlib import Path

import numpy as np
from scipy import ndimage

from gaga_core.arrays import IntArray, UInt8Array
from gaga_core.io.folder.scene_folder import open_scene_folder
from gaga_core.io.images import read_rgb
from gaga_core.io.masks.label_maps import view_key, write_labels
from gaga_core.pipeline.associate import associate_scene
from gaga_core.progress import run_stage


def my_masks(image: UInt8Array) -> IntArray:
    """Label map (H, W) int32 of a photo (H, W, 3): 0 = no mask. Ids of photos need not agree."""
    labels = np.zeros(image.shape[:2], np.int32)
    for level in range(4):
        pieces, _ = ndimage.label(image.mean(axis=2) // 64 == level)
        large = np.bincount(pieces.ravel()) >= 64
        inside = (pieces > 0) & large[pieces]
        labels[inside] = int(labels.max()) + pieces[inside]
    return labels


def main(path: Path) -> None:
    """Write SCENE/masks/mine, then find the objects."""
    folder = open_scene_folder(path)
    for name, photo in folder.image_paths.items():
        target = path / "masks" / "mine" / f"{view_key(name)}.png"
        target.parent.mkdir(parents=True, exist_ok=True)
        write_labels(target, my_masks(read_rgb(photo)))
    found = run_stage(associate_scene(open_scene_folder(path), "mine"))
    print(f"{found.bank.n_groups} groups of {len(found.bank.log)} masks")


if __name__ == "__main__":
    main(Path(sys.argv[1]))
