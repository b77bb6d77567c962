"""Associate the masks of a scene with both presets: compare_presets.py SCENE.

The groups of the last one, robust, stay in the scene folder.
"""

import sys

import gaga_core


def main(path: str) -> None:
    """Print objects and labelled Gaussians of each preset."""
    for preset in ("paper", "robust"):
        scene = gaga_core.find_objects(path, preset=preset)
        labelled = sum(len(thing) for thing in scene.objects.values())
        print(f"{preset:8s} {len(scene.objects)} objects, {labelled:,} Gaussians labelled")


if __name__ == "__main__":
    main(sys.argv[1])
