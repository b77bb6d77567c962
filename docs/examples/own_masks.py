"""Associate label maps that you made yourself: own_masks.py SCENE.

The maps of this example are the areas of similar brightness. Put your segmenter into `my_masks`.
"""

import sys

import numpy as np
from scipy import ndimage

import gaga_core


def my_masks(image: np.ndarray) -> np.ndarray:
    """Label map (H, W) int32 of a photo (H, W, 3): 0 = no mask. Ids of photos need not agree."""
    labels = np.zeros(image.shape[:2], np.int32)
    for level in range(4):
        pieces, _ = ndimage.label(image.mean(axis=2) // 64 == level)
        large = np.bincount(pieces.ravel()) >= 64
        inside = (pieces > 0) & large[pieces]
        labels[inside] = int(labels.max()) + pieces[inside]
    return labels


def main(path: str) -> None:
    """Write SCENE/masks/my_masks, then find the objects."""
    folder = gaga_core.segment(path, my_masks)
    scene = gaga_core.find_objects(path, masks=folder)
    print(f"{len(scene.objects)} objects")


if __name__ == "__main__":
    main(sys.argv[1])
