"""``python -m tests.screenshots [NAME ...]``: the pictures of README and guide, of the real window.

Each picture has a name (`PICTURES`) and goes to ``docs/images/NAME.png``. Without names all are
taken, on the demo scene, which is made first. Needs Xvfb, no display.
"""

import argparse
import io
import os
import shutil
import tempfile
from collections.abc import Callable, Iterable
from dataclasses import dataclass
from pathlib import Path
from typing import Literal

import numpy as np
from imgui_bundle import ImVec2
from imgui_bundle.immapp import testing
from PIL import Image

from gaga_core.demo.folder import ensure_demo
from gaga_core.progress import run_stage
from gaga_studio import commands
from gaga_studio.actions import (
    bank_timeline,
    camera_path,
    color_grade,
    files,
    folders,
    objects,
    quality,
)
from gaga_studio.session.session import Session
from gaga_studio.session.settings import Settings
from gaga_studio.session.view_state import Mode, ToolName
from gaga_studio.system import paths
from tests.app.window.driver import KEY, Driver, drive
from tests.display import xvfb

IMAGES = Path(__file__).resolve().parents[1] / "docs" / "images"
_DATA = Path(__file__).resolve().parents[2] / "shared" / "data"
_GUITAR = Path(os.environ.get("GAGA_TEST_DATA", _DATA)) / "splats" / "guitar.compressed.ply"
# How much of the demo scene is there; "guitar": a real thing, where its file is on this machine.
Opens = Literal["nothing", "photos", "masks", "objects", "guitar"]
_PATIENCE_S = 900.0
_SIZE = (1440, 900)  # pixels of the window
_MOST_BYTES = 450_000  # of a picture's file
_COLORS = (256, 192, 128, 96, 64, 48)  # of its palette; the first that keeps to the size
_FILM_WIDTH, _FILM_COLORS = 960, 96  # pixels; of its palette
_SIZES = {  # of the window and scale of its text, by name of the folder
    "800x500": ((800, 500), 1.0),
    "2560x1440": ((2560, 1440), 2.0),
}
_TEAPOT = (0.44, 0.57)  # where the demo's first view shows it, parts of the picture's size


@dataclass(frozen=True)
class Picture:
    """One picture: what it shows, and what has to be open for it."""

    name: str
    shows: str
    take: Callable[[Driver, "Shot"], None]
    opens: Opens = "objects"


class Shot:
    """Where a picture goes, and how it is saved."""

    def __init__(self, path: Path) -> None:
        self.path = path

    def window(self, d: Driver) -> None:
        """The whole window, at rest."""
        _rest(d)
        d.until(lambda: d.session.jobs.quiet is None, "the kernels are compiled")
        d.settle()
        self.now(d)

    def now(self, d: Driver) -> None:
        """The whole window as it is."""
        self.save(self.image(d))

    def image(self, d: Driver) -> Image.Image:
        """The whole window as it is, not saved."""
        with tempfile.TemporaryDirectory() as folder:
            file = Path(folder) / "window.png"
            testing.capture(d.engine, str(file))
            with Image.open(file) as image:
                return image.convert("RGB")

    def save(self, image: Image.Image) -> None:
        """``image`` with as many colors as fit into the size that a page can carry."""
        for colors in _COLORS:
            # Pillow diffuses the error only when it is given a palette.
            small = image.quantize(palette=image.quantize(colors))
            file = io.BytesIO()
            small.save(file, "PNG", optimize=True)
            if file.tell() <= _MOST_BYTES:
                break
        self.path.parent.mkdir(parents=True, exist_ok=True)
        self.path.write_bytes(file.getvalue())


class Film:
    """Pictures of a walk, one after the other, as one small moving picture."""

    def __init__(self, d: Driver, shot: Shot) -> None:
        self.d, self.shot = d, shot
        self.images: list[Image.Image] = []
        self.seconds: list[float] = []

    def see(self, seconds: float = 0.9) -> None:
        """Add the window as it is, for so long."""
        whole = self.shot.image(self.d)
        height = round(whole.height * _FILM_WIDTH / whole.width)
        self.images.append(whole.resize((_FILM_WIDTH, height), Image.Resampling.LANCZOS))
        self.seconds.append(seconds)

    def save(self, path: Path) -> None:
        """Write it as a .gif with one palette for all pictures."""
        strip = Image.new("RGB", (_FILM_WIDTH, sum(image.height for image in self.images)))
        for i, image in enumerate(self.images):
            strip.paste(image, (0, i * image.height))
        palette = strip.quantize(_FILM_COLORS)
        # Without diffused errors: noise that changes from picture to picture packs badly.
        frames = [
            image.quantize(palette=palette, dither=Image.Dither.NONE) for image in self.images
        ]
        times = [round(1000 * seconds) for seconds in self.seconds]
        path.parent.mkdir(parents=True, exist_ok=True)
        frames[0].save(path, save_all=True, append_images=frames[1:], duration=times, loop=0)


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
        os.environ["XDG_DATA_HOME"] = str(home / ".local")
        (home / "Documents").mkdir(parents=True, exist_ok=True)
        os.environ["GAGA_MODELS"] = "models"  # the dialogs of masks and models show this path
        os.chdir(home)
        here = [p.name for p in PICTURES if p.opens != "guitar" or _GUITAR.is_file()]
        names = chosen.names or here
        by_name = {picture.name: picture for picture in PICTURES}
        pictures = [by_name[name] for name in names]
        take(pictures, out)
        if sizes is not None:
            for name, (size, scale) in _SIZES.items():
                take(pictures, sizes / name, size, scale)


def take(
    pictures: Iterable[Picture], out: Path, size: tuple[int, int] = _SIZE, scale: float = 1.0
) -> None:
    """Take ``pictures``, each in a window of its own."""
    scenes = paths.home()
    run_stage(ensure_demo(scenes / "demo"))
    for picture in pictures:
        shot = Shot(out / f"{picture.name}.png")

        def walk(d: Driver, picture: Picture = picture, shot: Shot = shot) -> None:
            picture.take(d, shot)

        drive(
            walk,
            path=_opened(picture.opens, scenes),
            size=size,
            settings=Settings(first_steps_done=True, ui_scale=scale),
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
        session = Session(Settings())
        session.open(made)
        session.jobs.wait(_PATIENCE_S)
        files.associate(session)
        session.jobs.wait(_PATIENCE_S)
        session.save()
        session.jobs.wait(_PATIENCE_S)
        session.shut_down()
    return made


# --- what each picture shows


def _window(d: Driver, shot: Shot) -> None:
    _select_teapot(d)
    shot.window(d)


def _empty(d: Driver, shot: Shot) -> None:
    shot.window(d)


def _photos(d: Driver, shot: Shot) -> None:
    shot.window(d)


def _masks(d: Driver, shot: Shot) -> None:
    d.menu("Find/###Make masks…")
    dialog = d.studio.ui.scene.masks
    for n in (1, 2):  # the first compiles
        d.click("**/###Try on one photo")
        d.until(lambda n=n: dialog.n_previews == n, "one photo is done")  # type: ignore[misc]
        d.settle()
    shot.window(d)


def _models(d: Driver, shot: Shot) -> None:
    d.menu("Find/###Models…")
    shot.window(d)


def _find_objects(d: Driver, shot: Shot) -> None:
    """While the memory bank grows."""
    files.associate(d.session)
    d.until(lambda: _fraction(d.session) > 0.45, "half of the views are associated")
    _rest(d)
    d.frames()
    shot.now(d)
    d.settle()


def _fraction(session: Session) -> float:
    job = session.jobs.running
    return job.fraction if job is not None and session.live_labels is not None else 0.0


def _memory_bank(d: Driver, shot: Shot) -> None:
    group = _select_teapot(d)
    d.focus("Memory bank")
    decision = d.session.decisions(group)[2]
    d.click(f"**/{decision.view} {decision.mask}/##decision")
    shot.window(d)


def _timeline(d: Driver, shot: Shot) -> None:
    """The replay of the bank after its third view."""
    commands.run("view.timeline", d.session)
    timeline = bank_timeline.timeline_of(d.session)
    d.until(lambda: timeline.is_open, "the growth is known")
    d.on_main(lambda: bank_timeline.toggle_playing(d.session))
    d.on_main(lambda: bank_timeline.go_to_step(d.session, 3))
    shot.window(d)


def _split_view(d: Driver, shot: Shot) -> None:
    """A photo left of the line, the groups right of it."""
    commands.run("camera.split_photo_groups", d.session)
    shot.window(d)


def _select(d: Driver, shot: Shot) -> None:
    """A lasso on its way, over what another one selected."""
    d.session.tool = ToolName.LASSO
    width, height = d.size
    d.focus("Select by")
    corner = d.corner
    turns = np.linspace(0.0, 1.75 * np.pi, 40)
    d.move_to(0.56 * width, 0.57 * height)
    d.engine.mouse_down(0)
    for turn in turns:
        u, v = (0.44 + 0.12 * np.cos(turn)) * width, (0.57 + 0.16 * np.sin(turn)) * height
        d.engine.mouse_move_to_pos(ImVec2(corner[0] + u, corner[1] + v))
    d.frames()
    shot.now(d)
    d.engine.mouse_up(0)


def _click(d: Driver, shot: Shot) -> None:
    """The teapot by one click, in a scene without groups."""
    commands.run("tool.object", d.session)
    d.until(lambda: d.session.jobs.running is None, "the scene was looked at")
    width, height = d.size
    d.click_picture(width * _TEAPOT[0], height * _TEAPOT[1])
    shot.window(d)


def _click_real(d: Driver, shot: Shot) -> None:
    """A real guitar by one click, without the stand that it leans on."""
    commands.run("tool.object", d.session)
    d.until(lambda: d.session.jobs.running is None, "the scene was looked at")
    means = d.session.need().scene.gaussians.means
    d.click_picture(*d.project(np.median(means, axis=0).astype(np.float64)))
    shot.window(d)


def _edit(d: Driver, shot: Shot) -> None:
    _select_teapot(d)
    color_grade.recolor(d.session, (0.25, 0.45, 0.85))
    commands.run("tool.move", d.session)
    d.settle()
    shot.window(d)


def _search(d: Driver, shot: Shot) -> None:
    d.keys(KEY.mod_ctrl, KEY.f)
    d.engine.key_chars("largest red thing")
    document = d.session.need()
    d.until(lambda: bool(document.search.meant), "something is found")
    d.keys(KEY.down_arrow)
    shot.window(d)


def _camera_path(d: Driver, shot: Shot) -> None:
    for turn in (0, 160, 160, 160):
        d.session.rig.orbit(turn, 12)
        camera_path.add_keyframe(d.session)
    commands.run("camera.add_bookmark", d.session)
    d.focus("Camera path")
    shot.window(d)


def _export(d: Driver, shot: Shot) -> None:
    _select_teapot(d)
    d.menu("File/Export objects…")
    shot.window(d)


def _modes(d: Driver, shot: Shot) -> None:
    """The same view in groups, depth and confidence, next to each other."""
    shown = []
    for mode in (Mode.GROUPS, Mode.DEPTH, Mode.CONFIDENCE):
        d.session.view.mode = mode
        shown.append(Image.fromarray(d.pixels()))
    gap, width = 8, 460
    height = round(shown[0].height * width / shown[0].width)
    whole = Image.new("RGB", (3 * width + 2 * gap, height), "white")
    for i, image in enumerate(shown):
        whole.paste(image.resize((width, height), Image.Resampling.LANCZOS), (i * (width + gap), 0))
    shot.save(whole)


def _quality(d: Driver, shot: Shot) -> None:
    """The list with its column of quality, and the views in which an object agrees least."""
    quality.measure(d.session)
    d.settle()
    _select_teapot(d)
    d.click("Inspector/###Quality")
    shot.window(d)


def _folders(d: Driver, shot: Shot) -> None:
    """Objects in folders, one of them chosen, the groups in the colors of their folders."""
    session = d.session
    d.until(lambda: session.need().search.described is not None, "objects are described")
    named = list(zip(session.objects().ids.tolist(), session.objects().names, strict=True))

    def named_like(*words: str) -> list[int]:
        return [g for g, name in named if g and any(word in name for word in words)]

    colored = named_like("red ", "orange", "yellow", "green", "blue", "turquoise")
    folders.put_in(session, "Toys", colored)
    folders.put_in(session, "Toys/Round", [g for g in named_like("round") if g in colored])
    folders.put_in(session, "Dishes", named_like("white", "gold"))
    session.need().listing.toggle("Dishes")
    folders.choose(session, "Toys/Round")
    session.view.mode = Mode.GROUPS
    commands.run("view.folder_colors", session)
    shot.window(d)


def _six_clicks(d: Driver, shot: Shot) -> None:
    """Open, find, click, isolate, export: what the guide's film shows."""
    film, session = Film(d, shot), d.session
    shutil.rmtree(paths.exports(), ignore_errors=True)
    width, height = d.size
    d.move_to(0.5 * width, 0.85 * height)
    d.frames()
    film.see()
    for ref in ("Viewport/Try the demo", "**/###Find objects"):
        d.engine.mouse_move(f"//{ref}")
        d.frames()
        film.see()
        d.engine.mouse_click(0)
        d.frames(3)
        for share in (0.25, 0.6) if "Find" in ref else ():
            d.until(lambda share=share: _fraction(session) > share, "objects")  # type: ignore[misc]
            d.frames()
            film.see(0.6)
        d.settle()
        session.notices = ()
        film.see()
    width, height = d.size
    d.move_to(width * _TEAPOT[0], height * _TEAPOT[1])
    d.settle()
    film.see()
    d.engine.mouse_click(0)
    d.settle()
    film.see()
    for ref in ("Inspector/###Isolate", "Inspector/###Export…", "Export/###Export now"):
        d.engine.mouse_move(f"//{ref}")
        d.frames()
        film.see()
        d.engine.mouse_click(0)
        d.frames(3)
        d.settle()
        film.see(2.5 if "now" in ref else 0.9)
    film.save(shot.path.with_suffix(".gif"))


def _rest(d: Driver) -> None:
    """Nothing is hovered, and no notice is shown: those are read once and fade."""
    d.move_to(d.size[0] * 0.99, -20)  # an empty part of the tool bar
    d.session.notices = ()


def _select_teapot(d: Driver) -> int:
    """Click the object at the middle and name it; its group."""
    width, height = d.size
    d.click_picture(width * _TEAPOT[0], height * _TEAPOT[1])
    group = d.session.selected_groups()[0]
    objects.rename(d.session, group, "teapot")
    return group


PICTURES = (
    Picture("window", "the demo scene with groups, an object selected", _window),
    Picture("empty", "the window before anything is open", _empty, opens="nothing"),
    Picture("photos", "photos, offered for reconstruction", _photos, opens="photos"),
    Picture("masks", "the dialog that makes masks, tried on one photo", _masks, opens="masks"),
    Picture("models", "the sheet of models", _models, opens="nothing"),
    Picture("find_objects", "the memory bank while it grows", _find_objects, opens="masks"),
    Picture("memory_bank", "an object, its masks, and one of them on its photo", _memory_bank),
    Picture("timeline", "the replay of the memory bank", _timeline),
    Picture("split_view", "a photo and the groups with a line between them", _split_view),
    Picture("select", "a lasso on its way, and the panel Select by", _select),
    Picture("click", "a thing selected by one click, without groups", _click, opens="masks"),
    Picture("click_real", "a real guitar by one click, not its stand", _click_real, opens="guitar"),
    Picture("edit", "an object with another color and the handles that move it", _edit),
    Picture("search", "the search box and what it found", _search),
    Picture("camera_path", "a camera path of four places", _camera_path),
    Picture("export", "the sheet that exports the scene, the selection or objects", _export),
    Picture("six_clicks", "the way from nothing to a file, moving", _six_clicks, opens="nothing"),
    Picture("modes", "groups, depth and confidence of one view", _modes),
    Picture("folders", "objects in folders, in the colors of their folders", _folders),
    Picture("quality", "how well objects agree with their masks", _quality),
)

if __name__ == "__main__":
    main()
