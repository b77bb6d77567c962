"""What a picture of the guide is: what is open for it, how it is taken, how it is saved."""

import io
import tempfile
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import Literal

from imgui_bundle import ImVec2, imgui
from PIL import Image

from tests.app.window.driver import Driver

# How much of the demo scene is there; "guitar": a real thing, where its file is on this machine.
Opens = Literal["nothing", "photos", "masks", "objects", "guitar"]
_MOST_BYTES = 450_000  # of a picture's file
_COLORS = (256, 192, 128, 96, 64, 48)  # of its palette; the first that keeps to the size
_FILM_WIDTH, _FILM_COLORS = 960, 160  # pixels; of its palette
_REFINED = 2  # rounds that move the colors of a palette to where they are missed most


@dataclass(frozen=True)
class Picture:
    """One picture: what it shows, and what has to be open for it."""

    name: str
    shows: str
    take: Callable[[Driver, "Shot"], None]
    opens: Opens = "objects"


class Shot:
    """Where a picture goes, and how it is saved: whole where ``most_bytes`` is 0."""

    def __init__(self, path: Path, most_bytes: int = _MOST_BYTES) -> None:
        self.path, self._most_bytes = path, most_bytes

    def window(self, d: Driver) -> None:
        """The whole window, at rest."""
        rest(d)
        jobs = d.session.jobs
        d.until(lambda: jobs.quiet is jobs.preparing is None, "the kernels are compiled")
        d.settle()
        self.now(d)

    def now(self, d: Driver) -> None:
        """The whole window as it is."""
        self.save(self.image(d))

    def image(self, d: Driver) -> Image.Image:
        """The whole window as it is, not saved."""
        with tempfile.TemporaryDirectory() as folder:
            file = Path(folder) / "window.png"
            d.capture_now(file)
            with Image.open(file) as image:
                return image.convert("RGB")

    def save(self, image: Image.Image) -> None:
        """``image`` with as many colors as fit into the size that a page can carry."""
        self.path.parent.mkdir(parents=True, exist_ok=True)
        if self._most_bytes == 0:
            image.save(self.path)
            return
        for colors in _COLORS:
            # Pillow diffuses the error only when it is given a palette.
            small = image.quantize(palette=image.quantize(colors, kmeans=_REFINED))
            file = io.BytesIO()
            small.save(file, "PNG", optimize=True)
            if file.tell() <= self._most_bytes:
                break
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
        palette = strip.quantize(_FILM_COLORS, kmeans=_REFINED)
        # Without diffused errors: noise that changes from picture to picture packs badly.
        frames = [
            image.quantize(palette=palette, dither=Image.Dither.NONE) for image in self.images
        ]
        times = [round(1000 * seconds) for seconds in self.seconds]
        path.parent.mkdir(parents=True, exist_ok=True)
        frames[0].save(path, save_all=True, append_images=frames[1:], duration=times, loop=0)


def rest(d: Driver) -> None:
    """Nothing is hovered, no mouse is seen, no notice is shown: those are read once and fade."""
    d.engine.mouse_move_to_pos(ImVec2(1, imgui.get_io().display_size.y - 1))
    d.session.notices = ()
