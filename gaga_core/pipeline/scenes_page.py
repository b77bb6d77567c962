"""A page about many scenes that were run: what became of each, with a photo and its groups."""

import base64
import html
import io
from collections.abc import Mapping
from pathlib import Path

import numpy as np
from PIL import Image

from gaga_core.arrays import IntArray, UInt8Array
from gaga_core.errors import GagaError
from gaga_core.io.files import atomic_write
from gaga_core.io.images import read_rgb
from gaga_core.io.masks import read_labels, view_key
from gaga_core.io.scene_folder import AssociateEntry, open_scene_folder, read_report_entry
from gaga_core.pipeline.scene_tasks import SceneOutcome, ScenesReport
from gaga_core.scene.objects import group_colors

PAGE = "gaga-run.html"  # in the folder of scenes
_WIDTH = 240  # pixels of a picture
_STYLE = """
body { font: 15px/1.5 system-ui, sans-serif; margin: 2rem; color: #222; background: #fff }
table { border-collapse: collapse }
td, th { padding: .4rem .8rem; text-align: left; vertical-align: top }
td, th { border-bottom: 1px solid #ddd }
td.number { text-align: right }
tr.failed td { background: #fdecea }
img { width: 240px; display: inline-block; margin-right: 4px }
@media (prefers-color-scheme: dark) {
  body { color: #ddd; background: #1b1b1b }
  td, th { border-color: #444 }
  tr.failed td { background: #4a2320 }
}
"""


def write_page(path: Path, report: ScenesReport, folders: Mapping[str, Path]) -> None:
    """Write the page of ``report``; ``folders`` has the folder of every scene by its name.

    One file without scripts: the pictures are in it. A scene without groups has none.
    """
    rows = "\n".join(_row(outcome, folders[outcome.scene]) for outcome in report.outcomes)
    n, n_failed, n_again = len(report.outcomes), len(report.failed), len(report.requeued)
    page = f"""<!doctype html>
<html lang="en"><head><meta charset="utf-8"><title>gaga run: {n} scenes</title>
<style>{_STYLE}</style></head><body>
<h1>{n} scenes</h1>
<p>{n - n_failed} complete, {n_failed} not; {n_again} were started more than once, because a worker
ended without an answer.</p>
<table>
<tr><th>scene</th><th>complete</th><th>groups</th><th>stages run</th><th>seconds</th>
<th>attempts</th><th>photo and groups</th></tr>
{rows}
</table></body></html>
"""
    with atomic_write(path) as temporary:
        # Names of folders may have bytes that are no text: they become "?".
        temporary.write_text(page, encoding="utf-8", errors="replace")


def _row(outcome: SceneOutcome, folder: Path) -> str:
    entry = read_report_entry(folder / "gaga" / "report.json", "associate", AssociateEntry)
    try:
        pictures = _pictures(folder)
        note = ""
    except (GagaError, OSError) as error:  # a scene that failed may hold anything
        pictures, note = [], str(error)
    shown = "".join(f'<img alt="" src="{_inline(picture)}">' for picture in pictures)
    cells = [
        f"<td>{html.escape(outcome.scene)}</td>",
        f"<td>{html.escape(outcome.failed) or 'yes'}</td>",
        f'<td class="number">{"" if entry is None else entry.groups_with_gaussians}</td>',
        f"<td>{html.escape(', '.join(outcome.stages_run) or 'nothing')}</td>",
        f'<td class="number">{outcome.seconds:.0f}</td>',
        f'<td class="number">{outcome.attempts}</td>',
        f"<td>{shown or html.escape(note)}</td>",
    ]
    kind = ' class="failed"' if outcome.failed else ""
    return f"<tr{kind}>{''.join(cells)}</tr>"


def _pictures(root: Path) -> list[UInt8Array]:
    """The photo, where there is one, and the groups of the first view whose groups are drawn."""
    if not root.is_dir():
        return []
    folder = open_scene_folder(root)
    for camera in folder.cameras:
        drawn = folder.work / "renders" / "groups" / f"{view_key(camera.name)}.png"
        if drawn.is_file():
            photo = folder.image_paths.get(camera.name)
            return [*([] if photo is None else [_small(read_rgb(photo))]), _painted(drawn)]
    return []


def _painted(path: Path) -> UInt8Array:
    """A map of groups in the colors of the groups, small; no group is black."""
    groups = _every_nth(read_labels(path))
    ids, row = np.unique(groups, return_inverse=True)
    colors = group_colors(ids.astype(np.int32))
    colors[ids == 0] = 0
    painted: UInt8Array = (colors[row.reshape(groups.shape)] * 255 + 0.5).astype(np.uint8)
    return painted


def _every_nth(labels: IntArray) -> IntArray:
    step = max(1, labels.shape[1] // _WIDTH)
    return labels[::step, ::step]


def _small(image: UInt8Array) -> UInt8Array:
    height = max(1, round(image.shape[0] * _WIDTH / image.shape[1]))
    return np.asarray(Image.fromarray(image).resize((_WIDTH, height)))


def _inline(picture: UInt8Array) -> str:
    data = io.BytesIO()
    Image.fromarray(picture).convert("RGB").save(data, "WEBP", quality=80)
    return "data:image/webp;base64," + base64.b64encode(data.getvalue()).decode()
