"""A web page of a scene: one .html that shows the splats and lists the objects, without a network.

The viewer is `assets/web` with the shaders of the window; this writes it together with the splats,
rounded as in a SOG, as gzipped columns in base64. What comes from a scene is data of
the page: JSON that cannot end its element, put on the page as text. The page's policy lets nothing
run but its own script, and nothing load.
"""

import base64
import gzip
import hashlib
import html
import json
import re
from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from functools import cache
from pathlib import Path

import numpy as np

from gaga_core.arrays import AnyArray, IntArray
from gaga_core.camera import NEAR
from gaga_core.errors import GagaError
from gaga_core.gaussians import Gaussians
from gaga_core.geometry import look_at, matrices_to_quats
from gaga_core.io.files import assets, atomic_write
from gaga_core.io.splats.packing import (
    LEFT_OUT,
    bytes_of_logits,
    log_words,
    morton_order,
    nearest,
    palette_of,
    quat_bytes,
    say_changes,
    table_of,
)
from gaga_core.progress import Progress, Stage

MOST_DEGREE = 3  # of SH
ShotRow = tuple[float, ...]  # eye 3, cam_from_world wxyz 4, fields of view 2, distance 1
_MOST_OBJECTS = 1 << 16  # labels have 16 bits
_SCRIPTS = ("data", "camera", "renderer", "viewer", "panel", "input", "main")
_SHADERS = (
    "common.glsl", "full.vert", "project.frag", "quads.vert", "quads.frag", "composite.frag"
)  # fmt: skip
_STEPS = 8  # of progress
_STRAYS = 5.0  # percent of the splats at each end of an axis
_FOV, _QUARTER, _DOWN = 0.9, 0.52, 0.3  # radians: of the lens, from the front, from above
_STEEP = 0.9  # cosine between up and +z, from which on +z is no direction ahead


@dataclass(frozen=True)
class PageObject:
    """An object of the list. ``picture`` is a WebP; empty: none.

    An object under another one (``parent``) is in no folder of its own. One of the background is
    listed at the end, in a part that is closed at first; one that is locked cannot be selected.
    """

    id: int  # group id of the scene
    name: str
    color: tuple[float, float, float]
    count: int
    centre: tuple[float, float, float]
    radius: float
    picture: bytes = b""
    folder: str = ""  # path, "Kitchen/Cups"; empty: the top
    parent: int = 0  # place in the page's objects of the one that it lies under; 0: none
    is_background: bool = False
    is_locked: bool = False


@dataclass(frozen=True)
class PagePath:
    """A camera path as shots at even steps of time, at least two, from start to end."""

    shots: tuple[ShotRow, ...]
    seconds: float
    is_closed: bool = False


@dataclass(frozen=True, eq=False)
class Page:
    """Content of a page. ``objects`` begins with the splats of no object."""

    title: str
    gaussians: Gaussians  # world
    labels: IntArray  # (N,) place of each splat's object in ``objects``
    objects: tuple[PageObject, ...]
    up: tuple[float, float, float]
    radius: float  # of the scene
    start: ShotRow
    bookmarks: tuple[tuple[str, int, ShotRow], ...] = ()  # name, key 1..9 or 0, shot
    path: PagePath | None = None


STAGE = "Write page"


def write_page_stage(path: Path, page: Page) -> Stage[None]:
    """Write ``page`` as one .html, with progress. Whole or not at all.

    Raises ``GagaError`` when the place cannot be written, or the page has too many objects.
    """
    path = Path(path)
    check_room(len(page.objects) - 1)
    n = len(page.gaussians)
    columns: dict[str, str] = {}
    with atomic_write(path) as temporary:
        gaussians, labels = _sound(path, page.gaussians, page.labels)
        degree = min(gaussians.sh_degree, MOST_DEGREE)
        head: dict[str, object] = {"count": len(gaussians), "nSh": (degree + 1) ** 2}
        for done, (name, content) in enumerate(_columns(gaussians, labels, head)):
            yield Progress(STAGE, n * done // _STEPS, n, path.name)
            columns[name] = base64.b64encode(gzip.compress(content, mtime=0)).decode("ascii")
        yield Progress(STAGE, n, n, path.name)
        columns = {"scene": _json(_described(page, head)), **columns}
        # A title from the name of a folder may have bytes that are no text: they become "?".
        temporary.write_text(_assembled(page.title, columns), encoding="utf-8", errors="replace")


def check_room(n_objects: int) -> None:
    """Raise ``GagaError`` when a page cannot hold ``n_objects``, not counting "no object"."""
    if n_objects >= _MOST_OBJECTS:
        raise GagaError(
            f"A web page holds at most {_MOST_OBJECTS - 1:,} objects, and this scene has "
            f"{n_objects:,}. Merge or hide some."
        )


def viewer_bytes() -> int:
    """Size of a page without its scene, bytes."""
    return len(_assembled("", {}).encode())


# --- the scene as data


def _sound(path: Path, gaussians: Gaussians, labels: IntArray) -> tuple[Gaussians, IntArray]:
    """Splats that have a place and a size, neighbours next to each other."""
    sizes = gaussians.means.sum(axis=1) + gaussians.log_scales.sum(axis=1)
    rows = np.flatnonzero(np.isfinite(sizes) & ~np.isnan(gaussians.logit_opacities))
    say_changes(path, {LEFT_OUT: len(sizes) - len(rows)})
    rows = rows[morton_order(gaussians.means[rows])] if len(rows) else rows
    if len(rows) == 0:
        raise GagaError("There is nothing to write: no splats are visible.")
    return gaussians.take(rows), labels[rows]


def _columns(
    gaussians: Gaussians, labels: IntArray, head: dict[str, object]
) -> Iterator[tuple[str, bytes]]:
    """The columns by name; ``head`` is filled with what is to be known of them."""
    words, low, high = log_words(gaussians.means)
    head["low"], head["high"] = low.tolist(), high.tolist()
    yield "means", b"".join(_planes(words[:, axis]) for axis in range(3))
    largest, parts = quat_bytes(np.nan_to_num(gaussians.quats))
    yield "turns", parts.T.tobytes() + largest.tobytes()
    table = table_of(gaussians.log_scales)
    head["sizes"] = table.tolist()
    yield "sizes", nearest(table, gaussians.log_scales).T.tobytes()
    sh = np.nan_to_num(gaussians.sh[:, : int(np.square(MOST_DEGREE + 1))])
    table = table_of(sh[:, 0])
    head["colors"] = table.tolist()
    looks = nearest(table, sh[:, 0]).T.tobytes()
    yield "looks", looks + bytes_of_logits(gaussians.logit_opacities).tobytes()
    if sh.shape[1] > 1:
        entries, places = palette_of(sh[:, 1:])
        table = table_of(entries)
        head["shTable"] = table.tolist()
        yield "sh", nearest(table, entries).tobytes()
        yield "sh-places", _planes(places)
    yield "labels", _planes(labels)


def _planes(words: AnyArray) -> bytes:
    """Numbers of 16 bits as all low bytes, then all high ones: they pack better so."""
    return (words & 255).astype(np.uint8).tobytes() + (words >> 8).astype(np.uint8).tobytes()


def _described(page: Page, splats: Mapping[str, object]) -> dict[str, object]:
    path = page.path
    return {
        "title": page.title,
        "up": page.up,
        "radius": page.radius,
        "antialiased": page.gaussians.is_antialiased,
        "start": _rounded(page.start),
        "bookmarks": [
            {"name": name, "key": key, "shot": _rounded(shot)} for name, key, shot in page.bookmarks
        ],
        "path": None
        if path is None
        else {
            "shots": [_rounded(shot) for shot in path.shots],
            "seconds": path.seconds,
            "closed": path.is_closed,
        },
        "objects": [_entry(item) for item in page.objects],
        "splats": splats,
    }


def _entry(item: PageObject) -> dict[str, object]:
    picture = base64.b64encode(item.picture).decode("ascii")
    return {
        "id": item.id,
        "name": item.name,
        "color": [round(part, 3) for part in item.color],
        "count": item.count,
        "centre": _rounded(item.centre),
        "radius": float(f"{item.radius:.4g}"),
        "picture": f"data:image/webp;base64,{picture}" if picture else "",
        "folder": item.folder,
        "parent": item.parent,
        "background": item.is_background,
        "locked": item.is_locked,
    }


def _rounded(row: tuple[float, ...]) -> list[float]:
    return [float(f"{value:.7g}") for value in row]


def _json(value: object) -> str:
    """JSON that no element of a page ends in: nothing in it looks like a tag."""
    return json.dumps(value, separators=(",", ":")).replace("<", "\\u003c")


# --- the page


def _assembled(title: str, columns: Mapping[str, str]) -> str:
    page, style, script = _parts()
    policy = (
        f"default-src 'none'; script-src {_hash(script)}; style-src {_hash(style)}; "
        "img-src data:; worker-src blob:; base-uri 'none'; form-action 'none'"
    )
    # An element that is no script to the browser: its text is data.
    parts = "\n".join(
        f'<script type="text/plain" id="{name}">{text}</script>' for name, text in columns.items()
    )
    filled = {
        "title": html.escape(title),
        "policy": policy,
        "style": style,
        "script": script,
        "parts": parts,
    }
    return re.sub(r"\{\{(\w+)\}\}", lambda found: filled[found[1]], page)


@cache
def _parts() -> tuple[str, str, str]:
    """The page with its gaps, its style and its script."""
    web = assets() / "web"

    def text(path: Path) -> str:
        return path.read_text(encoding="utf-8")

    shaders = {name: text(assets() / "shaders" / name) for name in _SHADERS}
    shaders["common.glsl"] = f"#define NEAR {NEAR}\n" + shaders["common.glsl"]
    sort_worker = f"const NEAR = {NEAR};\n" + text(web / "sort_worker.js")
    script = "\n".join(
        [
            f"const SHADERS = {_json(shaders)};",
            f"const SORT_WORKER = {_json(sort_worker)};",
            *(text(web / f"{name}.js") for name in _SCRIPTS),
        ]
    )
    return text(web / "page.html"), text(web / "page.css"), script


def _hash(text: str) -> str:
    return f"'sha256-{base64.b64encode(hashlib.sha256(text.encode()).digest()).decode()}'"


# --- a page of splats alone


def plain_page(title: str, gaussians: Gaussians) -> Page:
    """A page of splats without objects, seen three quarters from the front; up is -y."""
    up = (0.0, -1.0, 0.0)  # of models without cameras: OpenCV axes
    start, radius = first_view(gaussians, up)
    nothing = np.zeros(len(gaussians), np.int32)
    everything = (no_object(len(gaussians)),)
    return Page(title, gaussians, nothing, everything, up, radius, start)


def no_object(count: int) -> PageObject:
    """The first entry of a list of objects: the splats of none."""
    return PageObject(0, "unassigned", (0.6, 0.6, 0.6), count, (0.0, 0.0, 0.0), 1.0)


def splat_reach(gaussians: Gaussians) -> float:
    """Three standard deviations of a usual splat: what a ball around few of them must hold."""
    longest = gaussians.log_scales.max(axis=1)
    longest = longest[np.isfinite(longest)]
    return 3 * float(np.exp(np.median(longest))) if len(longest) else 0.0


def first_view(gaussians: Gaussians, up: tuple[float, float, float]) -> tuple[ShotRow, float]:
    """A shot of all splats but strays, a little from above; and their radius."""
    axis, means = np.asarray(up, np.float64), gaussians.means
    finite = means[np.isfinite(means).all(axis=1)].astype(np.float64)
    if len(finite) == 0:
        finite = np.zeros((1, 3))
    low, high = np.percentile(finite, [_STRAYS, 100 - _STRAYS], axis=0)
    extent = float(np.linalg.norm(high - low)) / 2
    centre, radius = (low + high) / 2, max(extent, splat_reach(gaussians), 1e-6)
    # Models without cameras are made in a world where cameras look along +z.
    ahead = np.array([0.0, 0.0, 1.0]) if abs(axis[2]) < _STEEP else np.array([0.0, 1.0, 0.0])
    ahead -= (ahead @ axis) * axis
    ahead /= np.linalg.norm(ahead)
    side = np.cross(ahead, axis)
    level = np.cos(_QUARTER) * ahead + np.sin(_QUARTER) * side
    forward = np.cos(_DOWN) * level - np.sin(_DOWN) * axis
    distance = 1.15 * radius / float(np.sin(_FOV / 2))
    eye = centre - distance * forward
    quat = matrices_to_quats(look_at(eye, centre, axis)[None, :3, :3])[0]
    return (*eye.tolist(), *quat.tolist(), _FOV, _FOV, distance), radius
