"""The page of a data set: samples with their labels, and what it holds."""

import base64
import html
import io
from collections import Counter
from collections.abc import Sequence
from pathlib import Path

import numpy as np
from PIL import Image, ImageDraw

from gaga_core.color import group_palette
from gaga_core.export.dataset.formats import Source
from gaga_core.export.dataset.records import SPLITS, Record
from gaga_core.io.files import atomic_write
from gaga_core.io.images import read_rgb
from gaga_core.io.masks.coco import decode_rle
from gaga_core.progress import Progress, Stage

PAGE = "index.html"
_SAMPLES = 24
_WIDTH = 320  # pixels of a sample
_TINT = 0.45  # share of a class's color over an object
_BINS = 10  # of the visible share
_STYLE = """
body { font: 15px/1.5 system-ui, sans-serif; margin: 2rem; color: #222; background: #fff }
table { border-collapse: collapse; margin-bottom: 2rem }
td, th { padding: .3rem .8rem; text-align: left; border-bottom: 1px solid #ddd }
td.number { text-align: right }
figure { display: inline-block; margin: 0 8px 8px 0; width: 320px }
figcaption { font-size: 12px; color: #777 }
.bar { background: #4a7dbb; height: 10px }
@media (prefers-color-scheme: dark) {
  body { color: #ddd; background: #1b1b1b }
  td, th { border-color: #444 }
}
"""


def write_page_stage(source: Source, notes: Sequence[str] = ()) -> Stage[Path]:
    """Write index.html: one file without scripts, the samples are in it. Returns its path."""
    names = {row.id: row.name for row in source.tables.classes}
    rows = source.row_of()
    pictures, instances = Counter[str](), Counter[tuple[int, str]]()
    placements: dict[str, set[tuple[str, str]]] = {split: set() for split in SPLITS}
    shares, hidden = np.zeros(_BINS, np.int64), 0
    step, samples = max(1, len(source) // _SAMPLES), list[str]()
    for done, record in enumerate(source.records()):
        yield Progress("Write the page", done, len(source))
        pictures[record.split] += 1
        placements[record.split].add((record.scene, record.placement))
        for one in record.objects:
            hidden += one.area == 0
            if one.area:
                instances[rows[record.scene, one.group].class_id, record.split] += 1
                shares[min(int(one.visible_share * _BINS), _BINS - 1)] += 1
        if done % step == 0 and len(samples) < _SAMPLES:
            colors = {one.group: rows[record.scene, one.group].class_id for one in record.objects}
            samples.append(_sample(source.root, record, colors, names))
    split_rows = [(split, pictures[split], len(placements[split])) for split in SPLITS]
    class_rows = [(names[k], k, *(instances[k, split] for split in SPLITS)) for k in sorted(names)]
    scene_rows = [(s.scene, len(s.names), s.left_out, len(s.objects)) for s in source.scenes]
    share_rows = [
        (f"{100 * k // _BINS} to {100 * (k + 1) // _BINS} %", int(n)) for k, n in enumerate(shares)
    ]
    share_rows.append(("hidden (amodal labels only)", hidden))
    text = f"""<!doctype html>
<html lang="en"><head><meta charset="utf-8"><title>Data set: {len(source):,} pictures</title>
<style>{_STYLE}</style></head><body>
<h1>{len(source):,} pictures of {len(source.scenes)} scenes</h1>
{"".join(f"<p>{html.escape(note)}</p>" for note in notes)}
{_table(("split", "pictures", "placements"), split_rows)}
{_table(("scene", "pictures", "views left out", "objects"), scene_rows)}
<h2>Classes</h2>
{_table(("class", "id", "instances, train", "instances, validation"), class_rows)}
<h2>How much of an object is seen</h2>
{_table(("visible share", "instances"), share_rows)}
<h2>Samples</h2>
{"".join(samples)}
</body></html>
"""
    with atomic_write(source.root / PAGE) as temporary:
        temporary.write_text(text, encoding="utf-8", errors="replace")
    return source.root / PAGE


def _table(headings: Sequence[str], rows: Sequence[Sequence[object]]) -> str:
    head = "".join(f"<th>{html.escape(text)}</th>" for text in headings)
    body = "".join(
        "<tr>"
        + "".join(
            f'<td class="number">{cell:,}</td>'
            if isinstance(cell, int)
            else f"<td>{html.escape(str(cell))}</td>"
            for cell in row
        )
        + "</tr>\n"
        for row in rows
    )
    return f"<table>\n<tr>{head}</tr>\n{body}</table>"


def _sample(root: Path, record: Record, classes: dict[int, int], names: dict[int, str]) -> str:
    """A picture with masks in the colors of their classes, boxes and names."""
    picture = read_rgb(root / record.file("images")).astype(np.float32) / 255
    palette = group_palette(max([*classes.values(), 1]) + 1)
    for one in record.objects:
        if one.area:
            mask = decode_rle(one.counts, (record.height, record.width))
            color = palette[classes[one.group]]
            picture[mask] = (1 - _TINT) * picture[mask] + _TINT * color
    image = Image.fromarray((np.clip(picture, 0, 1) * 255).astype(np.uint8))
    drawing = ImageDraw.Draw(image)
    for one in record.objects:
        x, y, w, h = one.box
        if one.area:
            red, green, blue = (int(255 * c) for c in palette[classes[one.group]])
            drawing.rectangle((x, y, x + w - 1, y + h - 1), outline=(red, green, blue))
    scale = _WIDTH / image.width
    data = io.BytesIO()
    image.resize((_WIDTH, max(1, round(image.height * scale)))).save(data, "WEBP", quality=80)
    inline = base64.b64encode(data.getvalue()).decode()
    told = ", ".join(sorted({names[classes[one.group]] for one in record.objects if one.area}))
    return (
        f'<figure><img alt="{html.escape(told)}" src="data:image/webp;base64,{inline}">'
        f"<figcaption>{html.escape(record.name)} ({record.split}), placement "
        f"{html.escape(record.placement)}: {html.escape(told)}</figcaption></figure>\n"
    )
