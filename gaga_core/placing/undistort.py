"""From a checked model to a scene folder: pictures without lens distortion, PINHOLE cameras.

SCENE/images and SCENE/sparse/0 appear one after the other, the model last: it is the sign that the
step is done. Pictures that lay in SCENE/images go to SCENE/input; nothing of the user's is removed.
"""

import json
import shutil
from pathlib import Path

from gaga_core.arrays import DoubleArray
from gaga_core.errors import GagaError
from gaga_core.io.depth_maps import DEPTH
from gaga_core.io.files import explain_os_error, refuse_links
from gaga_core.io.folder.scene_folder import FOREGROUND
from gaga_core.placing.photos import MASKS, PhotoSet
from gaga_core.placing.sfm import UPRIGHT, SfmConfig, run_step
from gaga_core.progress import Progress, Stage

ORIGINALS = "input"  # folder in the scene for photos as they came (as in the original 3DGS work)


def undistort_into(
    scene: Path,
    photos: PhotoSet,
    workspace: Path,
    config: SfmConfig,
    *,
    longest_side: int,  # pixels
    replaces: Path | None = None,  # the folder that the photos came from
) -> Stage[None]:
    """Undistort workspace/photos by workspace/model and move the result into ``scene``.

    Raises ``GagaError`` when ``scene`` holds other pictures already.
    """
    out = workspace / "undistorted"
    yield from run_step("undistort", photos, workspace, config, picture_side=longest_side)
    yield Progress("Undistort photos", 1, 1, "move into place")
    try:
        if (out / "images").is_dir():
            require_room(scene, replaces, workspace)
            if (scene / "images").exists():
                (scene / "images").replace(scene / ORIGINALS)
            shutil.move(out / "images", scene / "images")
        for made, name in ((MASKS, FOREGROUND), (DEPTH, DEPTH)):
            if (out / made).is_dir():
                refuse_links(scene / name, scene)
                shutil.rmtree(scene / name, ignore_errors=True)
                shutil.move(out / made, scene / name)
        refuse_links(scene / "sparse", scene)
        (scene / "sparse").mkdir(exist_ok=True)
        (out / "sparse" / "0").replace(scene / "sparse" / "0")
    except OSError as error:
        raise GagaError(explain_os_error(error, scene)) from error


def write_upright(workspace: Path, turn: DoubleArray) -> None:
    """Write how `undistort_into` is to turn the world: a rotation (3, 3)."""
    (workspace / UPRIGHT).write_text(json.dumps(turn.tolist()), encoding="utf-8")


def require_room(scene: Path, replaces: Path | None, workspace: Path) -> None:
    """``GagaError`` when ``scene`` holds other pictures than those that are to be replaced."""
    images, out = scene / "images", workspace / "undistorted"
    was_moved = out.is_dir() and not (out / "images").exists()  # by a run that was ended then
    if was_moved or not images.exists():
        return
    own = replaces is not None and replaces.resolve() == images.resolve()
    if not own or (scene / ORIGINALS).exists():
        raise GagaError(
            f"{images} holds other pictures already. Choose another scene folder, or move them."
        )
