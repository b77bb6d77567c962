"""``python -m tests.screenshots [NAME ...]``: the pictures of README and guide, of the real window.

Each picture has a name (`PICTURES`) and goes to ``docs/images/NAME.png``. Without names all are
taken, on the demo scene. Needs Xvfb, no display.
"""

import argparse
import os
import shutil
import tempfile
from collections.abc import Iterable
from pathlib import Path

from gaga_core.io.demo_scene import ensure_demo
from gaga_core.progress import run_stage
from gaga_studio.features.commands import new_session
from gaga_studio.features.find import association
from gaga_studio.session.settings import Settings
from gaga_studio.system import paths
from tests.app.window.driver import Driver, drive
from tests.display import xvfb
from tests.guide_pictures import PICTURES
from tests.shots import Opens, Picture, Shot

IMAGES = Path(__file__).resolve().parents[1] / "docs" / "images"
_DATA = Path(__file__).resolve().parents[2] / "shared" / "data"
_GUITAR = Path(os.environ.get("GAGA_TEST_DATA", _DATA)) / "splats" / "guitar.compressed.ply"
_PATIENCE_S = 900.0
_GUIDE = ((1440, 900), 1.0)  # pixels of the window, and scale of its text
_SIZES = {  # the same of pictures that are taken to be looked at, by name of the folder
    "800x500": ((800, 500), 1.0),
    "2560x1440": ((2560, 1440), 2.0),
}


def main() -> None:
    """Take the pictures that are asked for."""
    parser = argparse.ArgumentParser(description="Take the pictures of README and guide.")
    parser.add_argument("names", nargs="*", help=", ".join(p.name for p in PICTURES))
    parser.add_argument("--out", type=Path, default=IMAGES)
    parser.add_argument("--home", type=Path, help="keeps the demo scene between runs")
    parser.add_argument(
        "--sizes", type=Path, help=f"also take them at {', '.join(_SIZES)}, into this folder"
    )
    chosen = parser.parse_args()
    unknown = set(chosen.names) - {picture.name for picture in PICTURES}
    if unknown:
        parser.error(f"no such picture: {', '.join(sorted(unknown))}")
    with tempfile.TemporaryDirectory() as folder, xvfb((2560, 1440)):
        home = (chosen.home or Path(folder)).resolve()
        out = chosen.out.resolve()
        sizes = chosen.sizes.resolve() if chosen.sizes else None
        os.environ["HOME"] = str(home)
        os.environ.pop("GAGA_HOME", None)  # paths are shown as users see them, from ~ on
        os.environ.pop("GAGA_MODELS", None)
        os.environ["XDG_DATA_HOME"] = str(home / ".local" / "share")
        (home / "Documents").mkdir(parents=True, exist_ok=True)
        os.chdir(home)
        here = [p.name for p in PICTURES if p.opens != "guitar" or _GUITAR.is_file()]
        names = chosen.names or here
        by_name = {picture.name: picture for picture in PICTURES}
        pictures = [by_name[name] for name in names]
        take(pictures, out, "1440x900")
        if sizes is not None:
            for name in _SIZES:
                take(pictures, sizes / name, name)


def take(pictures: Iterable[Picture], out: Path, size_name: str) -> None:
    """Take ``pictures``, each in a window of its own; those of other sizes keep all colors."""
    scenes, (size, scale) = paths.home(), _SIZES.get(size_name, _GUIDE)
    run_stage(ensure_demo(scenes / "demo"))
    for picture in pictures:
        file = out / f"{picture.name}.png"
        shot = Shot(file, most_bytes=0) if size_name in _SIZES else Shot(file)

        def walk(d: Driver, picture: Picture = picture, shot: Shot = shot) -> None:
            picture.take(d, shot)

        drive(
            walk,
            path=_opened(picture.opens, scenes),
            size=size,
            settings=Settings(first_steps_done=True, ui_scale=scale),
            fills_window=True,
            patience_s=_PATIENCE_S,
        )


def _opened(what: Opens, scenes: Path) -> Path | None:
    """What the window opens; made of the demo scene when it is first needed."""
    demo, made = scenes / "demo", scenes / what / "table"
    if what == "nothing":
        return None
    if what == "guitar":
        return _GUITAR
    if what == "masks":
        return demo
    if what == "photos" and not made.exists():
        shutil.copytree(demo / "images", made / "images")
    if what == "objects" and not made.exists():
        shutil.copytree(demo, made)
        session = new_session(Settings())
        session.open(made)
        session.jobs.wait(_PATIENCE_S)
        association.associate(session)
        session.jobs.wait(_PATIENCE_S)
        session.save()
        session.jobs.wait(_PATIENCE_S)
        session.shut_down()
    return made


if __name__ == "__main__":
    main()
