"""The tables of docs/performance.md: the figures that a reader needs, and what is known of each.

``python -m tests.bench --tables`` makes the tables from the record and writes them into the page,
each under its heading. Values come from `record.json`; what they are measured on, whether that was
used to choose anything, and their bars stand here and nowhere else on paper. A benchmark that
measures a figure with another bar than its row says so (`other_bars`).
"""

import re
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path

from tests.bench.figures import Figure
from tests.bench.record import Record

PAGE = Path(__file__).resolve().parents[2] / "docs" / "performance.md"
_HEAD = "| figure | value | bar | measured on | used to choose |\n|---|---|---|---|---|\n"


@dataclass(frozen=True)
class Data:
    """What figures are measured on."""

    said: str
    used: str  # to choose a setting or a rule: "no", or for what; "–" for speed and memory


@dataclass(frozen=True)
class Row:
    """One row of a table: one figure, or several with a slash between them."""

    said: str
    on: Data
    figures: tuple[str, ...] = ()  # names in the record
    bars: tuple[str, ...] = ()  # of each figure, as its benchmark has it; missing: none
    unit: str = ""
    factor: int = 1  # 100 shows a share in percent
    once: tuple[float, ...] = ()  # values measured by hand, too long for the record

    @property
    def values(self) -> tuple[tuple[str, str], ...]:
        """Name and bar of each figure."""
        bars = (*self.bars, *("",) * (len(self.figures) - len(self.bars)))
        return tuple(zip(self.figures, bars, strict=True))


_QUALITY = Data("10 generated rooms and tables, seeds 11 to 15", "rooms 12 to 14")
_SPARSE = Data("rooms and tables, seeds 11 and 12, 4 of 80 views", "room 12")
_PARTS = Data("150 objects of parts, seeds 31 to 35", "looked at seed 31")
_IDENTITY = Data("6 generated scenes, seeds 31 to 33", "no")
_TABLE = Data("ycb_table, 8 held-out views", "yes")
_CROWD = Data("ycb_crowd, 8 held-out views", "yes")
_CROWD_SPEED = Data("ycb_crowd", "–")
_DEMO = Data("demo scene, 5 held-out views", "yes")
_FOX = Data("fox", "no")
_GARDEN, _YCB = Data("garden", "yes"), Data("ycb_table", "yes")
_SPLATS, _HALL = Data("generated splats", "–"), Data("generated halls of boxes, seed 0", "–")
_SMALL = Data("generated floor of 1,728 tiles, 768 masks a view", "no")
_LANDSCAPE = Data("generated landscape", "–")

_SCORES = ("IoU", "precision", "recall")
_LABELLED = Data("generated scenes", "yes")
_DETECTOR = (
    *(f"AP on unseen photos, of {k}" for k in ("photos", "data", "both")),
    "worst gain of a seed by data",
    "worst gain of a seed by both",
)
_SOLIDS = ("parts", "one hull")  # of a body
_LEFT_OF = ("fox", "demo", "tankard", "sceaux")
_OF_FEW = ("groups a true object", "recall")
_OBJECT_BARS = (">= 0.87", ">= 0.82", ">= 0.95", ">= 0.97")


def _quality(said: str, variant: str) -> Row:
    keys = (key.lower() for key in _SCORES)
    return Row(said, _QUALITY, tuple(f"quality: {variant}, {key}" for key in keys))


def _conversion(form: str) -> Row:
    title = f"peers: 1M splats to {form}"
    names = tuple(f"{title}, {end}" for end in ("ours", "splat-transform", "ours to theirs"))
    said = f"1M splats, degree 3, to {form}: ours / splat-transform in CPU-s / the ratio"
    return Row(said, _SPLATS, names, ("", "", "<= 0.5"))


def _peer(name: str, data: Data) -> Row:
    ours, theirs = f"peers: {name}, ours, a draft", f"peers: {name}, OpenSplat, 300 steps"
    said = "a draft here / 300 steps of OpenSplat: CPU-s, then dB of held-out photos"
    return Row(said, data, (ours, theirs, f"{ours}, held-out", f"{theirs}, held-out"))


def _parts(said: str, variant: str, after: str = "", bar: str = "") -> Row:
    names = tuple(f"parts: {variant}, {key.lower()}{after}" for key in _SCORES)
    return Row(said, _PARTS, names, (bar,) * 3)


def _real(preset: str, *bars: str) -> Row:
    names = tuple(f"ycb_table: {preset}, {key.lower()}" for key in _SCORES)
    return Row(f"from masks: {preset}", _TABLE, names, bars, factor=100)


def _objects(scene: str, on: Data, *bars: str) -> Row:
    keys = (*_SCORES, "recall at the best level")
    return Row(
        "without a model", on, tuple(f"objects: {scene}, {k}" for k in keys), bars, factor=100
    )


def _clicks(scene: str, on: Data) -> Row:
    name = f"click: {scene}, clicks to IoU 0.9"
    return Row("clicks to IoU 0.9", on, (name,), ("<= 3",))


def _fill(kind: str, said: str, used: str) -> Row:
    keys = ("gain in the hole", "least of it", "outside, mean", "outside, least")
    names = tuple(f"fill: {kind}, {key}" for key in keys)
    return Row("delete and fill", Data(said, used), names, (">= 6", "", ">= -0.05"))


_FIRST_MINUTE = ("demo opened", "outline", "names", "thumbnails")
_FILM = ("the scene turns", "splats of the training")


def _speed(said: str, name: str, bar: str = "", unit: str = "", on: Data = _SPLATS) -> Row:
    return Row(said, on, (name,), (bar,), unit)


def _hall(boxes: int, views: int, used: str) -> Row:
    name = f"hall: {boxes} boxes, {views} views"
    return Row(
        f"{boxes:,} boxes in {views:,} views: precision / recall",
        Data(_HALL.said, used),
        (f"{name}: precision", f"{name}: recall"),
        factor=100,
    )


TABLES: Mapping[str, Sequence[Row]] = {
    "Objects": [
        Row(
            "from masks, identities: vote / refined / 2,000 steps of training, IoU",
            _IDENTITY,
            tuple(
                f"identity: held-out IoU, 6 scenes, {key}"
                for key in ("vote", "refine", "2,000 steps from zeros")
            ),
        ),
        _parts("from masks: paper", "paper, vote"),
        _parts("from masks: robust", "robust, vote"),
        _parts(
            "from masks: robust less paper, worst seed", "robust over paper", ", worst seed", ">= 0"
        ),
        Row(
            "from masks: robust, share of the IoU of true labels",
            _PARTS,
            ("parts: robust, IoU as a share of true labels'",),
            (">= 0.95",),
            factor=100,
        ),
        _quality("from masks: paper", "paper"),
        _quality("from masks: robust", "robust"),
        Row(
            "from masks: robust less paper",
            _QUALITY,
            tuple(f"quality: robust over paper, {key}" for key in _SCORES),
            (">= 10", ">= 30", ">= 10"),
        ),
        Row(
            "from masks: paper / robust, IoU",
            _SPARSE,
            ("sparse: paper, IoU with 5 % of them", "sparse: robust, IoU with 5 % of them"),
        ),
        _real("paper"),
        _real("robust", ">= 0.9", ">= 0.8", ">= 1"),
        Row(
            "without a model, by samples of the surface: `python -m tools.learn_objects test`",
            Data("30 test scenes of scanned objects, 12 of the objects in no other scene", "no"),
            once=(88.5, 92.7, 93.9),
        ),
        _objects("room", Data("generated room, seed 0", "other seeds")),
        _objects("table", Data("generated table, seed 0", "other seeds")),
        _objects("contents", Data("generated bowls, rows of books, chairs, seed 0", "other seeds")),
        _objects("parts", Data("generated objects of parts, seed 0", "other seeds")),
        _objects("ycb_table", _TABLE, *_OBJECT_BARS),
        _objects("ycb_crowd", _CROWD, *_OBJECT_BARS),
        _objects("demo", Data("demo scene, 5 held-out views", "no"), ">= 0.65", ">= 0.50"),
        *(
            Row(
                "listed groups for each true object, recall: 9, 12 and 15 photos",
                Data(said, used),
                tuple(f"objects: {name}, 9 to 15 photos, {k}" for k in _OF_FEW),
                ("<= 1.5",),
            )
            for name, said, used in (
                ("room", "generated room, seed 0", "other seeds"),
                ("demo", "demo scene", "no"),
            )
        ),
        Row(
            "best region of each object, IoU: color / with depth",
            _TABLE,
            ("regions: ycb_table, color, best IoU", "regions: ycb_table, depth, best IoU"),
            (">= 0.62", ">= 0.70"),
            factor=100,
        ),
        _clicks("ycb_crowd", Data("27 objects of ycb_crowd", "yes")),
        _clicks("demo", Data("48 objects of the demo scene", "a quarter of them")),
        Row(
            "objects selected whole by the first click: tool Pick / Object",
            Data("26 objects of ycb_crowd", "yes"),
            tuple(f"first click: ycb_crowd, tool {t}, selected whole" for t in ("Pick", "Object")),
            (">= 20", ">= 20"),
        ),
    ],
    "Made from objects": [
        _fill("drawn", "6 drawn scenes, seeds 216 to 221", "no"),
        _fill("demo, kept back", "5 objects of the demo scene, seeds 3 and 4", "no"),
        _fill("solids", "8 generated solids, seeds 2 and 3", "yes"),
        _fill("demo", "4 objects of the demo scene, seeds 1 and 2", "yes"),
        _fill("ycb_crowd", "5 places of ycb_crowd, seed 2", "yes"),
        Row(
            "IoU of visible labels with the truth: splats that scatter by 0, 0.3 and 1",
            _LABELLED,
            tuple(f"data: IoU of ids with the truth, noise {k}" for k in ("0.0", "0.3", "1.0")),
            (">= 0.95", ">= 0.95", ""),
        ),
        Row(
            "pictures with all labels: time of drawing alone / memory of 800, to that of 200",
            Data("demo scene", "yes"),
            (
                "data: pictures with labels, times drawing alone",
                "data: peak memory of 800 pictures, times that of 200",
            ),
            ("<= 1.3", "<= 1.05"),
            "times",
        ),
        Row(
            "AP of a detector on other photos: 8 labelled photos / our pictures / both, and the "
            "worst gain of 5 seeds by our pictures / by both",
            Data("a generated scene", "number of steps alone"),
            tuple(f"detector: {k}" for k in _DETECTOR),
            ("", "", "", ">= 0", ">= 0"),
        ),
        Row(
            "bodies for simulators: objects found",
            _YCB,
            ("bodies: scanned objects found",),
            (">= 12",),
        ),
        Row(
            "Chamfer distance of the mesh to the scan where it was seen: median / worst",
            _YCB,
            ("bodies: Chamfer, median", "bodies: Chamfer, worst"),
            ("<= 3", ""),
            "mm",
        ),
        Row(
            "error of the mass at the true density, median",
            _YCB,
            ("bodies: error of mass, median",),
            ("<= 30",),
            "%",
        ),
        Row(
            "share that 2 s later are within 5 mm and 3 degrees of where they stood, and still",
            _YCB,
            ("bodies: share that rest where they stood",),
            (">= 1",),
        ),
        *(
            Row(
                "share of bowls and mugs that hold a ball of 30 mm: convex parts / one hull",
                data,
                tuple(f"bodies: vessels of {k} that hold a ball, {s}" for s in _SOLIDS),
                (">= 1", ""),
            )
            for k, data in (("ycb_table", _YCB), ("ycb_crowd", Data("ycb_crowd", "no")))
        ),
    ],
    "Photos to splats": [
        Row(
            "draft: processor time of that before, at the same dB: fox / ycb_table / sceaux",
            Data("fox, ycb_table, sceaux", "ycb_table"),
            once=(0.49, 0.53, 0.53),
            unit="times",
        ),
        Row("161 photos: `standard` / `full`", _GARDEN, once=(26.8, 27.1), unit="dB"),
        Row("placed by given poses: time of placing without them", _FOX, once=(56.0,), unit="%"),
        Row("poses 1 degree, 2 cm off: refined / true", _YCB, once=(25.1, 25.0), unit="dB"),
        Row(
            "photos to splats: the time left is off by, from a tenth of the time on",
            Data("drafts of fox, demo, tankard, sceaux, one after the other", "all but tankard"),
            tuple(
                f"time left: {k}, wrong by at most" for k in ("fox", "demo", "tankard", "sceaux")
            ),
            ("<= 1.5",) * 4,
            unit="times",
        ),
        *(
            Row(
                "photos placed to: the scene turns in the window / shows trained splats",
                data,
                tuple(f"training film: {name}, photos placed to {step}" for step in _FILM),
                ("<= 15", ""),
                "s",
            )
            for name, data in (("fox", _FOX), ("demo", _DEMO))
        ),
        Row("captures that do what they must, of 17", Data("`make captures`", "yes"), once=(17,)),
        *(
            Row(
                f"halves of {name}, placed apart and aligned: draws within 0.5 degrees and 0.5 % / "
                "refused / median degrees / % of scale",
                data,
                tuple(
                    f"align: halves of {name}, 10 draws, {k}"
                    for k in (
                        "within 0.5 degrees and 0.5 %",
                        "refused",
                        "median angle",
                        "median error of scale",
                    )
                ),
                (">= 9",),
            )
            for name, data in (
                ("demo", Data("20 and 20 photos, no EXIF", "no")),
                ("garden", Data("30 and 30 photos, no EXIF", "no")),
            )
        ),
        *(
            Row(
                f"{said}: photos placed / PSNR of the object in held-out photos / IoU of the best "
                "group / alpha outside the object",
                Data("tankard, 69 photos of a turntable", "masks of the backdrop"),
                tuple(
                    f"{name}: {k}"
                    for k in (
                        "photos placed",
                        "held-out PSNR of the object",
                        "IoU of the best group",
                        "alpha outside the object",
                    )
                ),
                (">= 69", ">= 26", ">= 0.9", "<= 0.05"),
            )
            for said, name in (
                ("no option", "tankard"),
                ("its true masks", "tankard foreground"),
                ("its published poses", "tankard poses"),
            )
        ),
        Row(
            "turntables of 40 photos, of 12: placed / one group of IoU 0.9",
            Data("12 generated turntables of scanned objects", "box, tin, can on black"),
            ("twelve turntables: placed", "twelve turntables: one group of IoU 0.9"),
            (">= 11", ">= 10"),
        ),
    ],
    "Speed, memory, many objects": [
        _hall(4000, 1000, "no"),
        Row(
            "4,000 to 1,000 boxes: time",
            _HALL,
            ("hall: 4000 boxes, 1000 views, to 1000, 300: time",),
            ("<= 8",),
            "times",
        ),
        Row(
            "4,000 boxes: peak memory",
            _HALL,
            ("hall: 4000 boxes, 1000 views: peak memory",),
            ("<= 4096",),
            "MiB",
        ),
        Row(
            "125 boxes, 40 to 5,000 views: largest miss of the best line",
            _HALL,
            ("hall: 125 boxes, 320x240: largest miss of the line",),
            ("<= 0.1",),
            "%",
            100,
        ),
        Row(
            "5,000 small views: precision / recall",
            _SMALL,
            (
                "small views: 5000 of 768 masks: precision",
                "small views: 5000 of 768 masks: recall",
            ),
            factor=100,
        ),
        Row(
            "100 to 5,000 small views: largest miss of the best line",
            _SMALL,
            ("small views: largest miss of the line",),
            ("<= 0.05",),
            "%",
            100,
        ),
        Row(
            "a quarter of the views joins later: IoU less that of all at once, mean / worst",
            Data("3 generated halls", "yes"),
            (
                "joining: 3 halls, a quarter of the views later, IoU, less that of all at once",
                "joining: 3 halls, a quarter of the views later, the same, worst",
            ),
            (">= -1",),
        ),
        *(_conversion(form) for form in ("compressed .ply", ".spz", ".sog", ".glb")),
        *(_peer(name, data) for name, data in (("fox", _FOX), ("garden", _GARDEN))),
        _speed(
            "association of a view, 1M splats, 54 masks",
            "associate: a view at 1M, 54 masks, without depth",
            "<= 60",
            "CPU-ms",
        ),
        _speed("error of the rasterizer", "raster: mean error against float64", "<= 1e-5"),
        _speed(
            "a pure-torch renderer, to ours",
            "raster: pure-torch tile loop to that",
            ">= 20",
            "times",
        ),
        Row(
            "compile kernels, once: for clicks, names and thumbnails / and for all editing",
            _SPLATS,
            (
                "kernels: compile for clicks, object list, thumbnails, names",
                "kernels: compile for viewing, picking, editing",
            ),
            ("", "<= 60"),
            "CPU-s",
        ),
        Row(
            "nothing compiled yet: the demo opens / then outline / names / thumbnails",
            _DEMO,
            tuple(f"first minute: {step}" for step in _FIRST_MINUTE),
            ("<= 3", "<= 5", "<= 5", "<= 5"),
            "s",
        ),
        _speed("open 4M splats, to numpy", "open 4M against numpy's columns", "<= 1.5", "times"),
        _speed("click among 4M splats", "4M: click, CPU of all threads", "<= 50", "CPU-ms"),
        _speed("depth sort of 3M", "3M: depth sort with cull, one thread", "<= 40", "CPU-ms"),
        _speed(
            "identities by vote, 40 views, 200k splats",
            "identity: vote and fit, 40 views 640x480, 200k, 100 groups",
            "",
            "CPU-s",
        ),
        _speed(
            "find objects on 47 photos: masks, groups and identities",
            "find objects: 47 photos, together",
            "<= 20",
            "CPU-s",
            _CROWD_SPEED,
        ),
        _speed(
            "search 500 objects by words",
            "query: 500 groups ranked by words",
            "<= 50",
            "CPU-ms",
        ),
        _speed(
            "a step of training, 60k splats, degree 3",
            "train: a step, 60k, 320x240, degree 3",
            "<= 65",
            "CPU-ms",
        ),
        _speed(
            "window with 5,000 objects, a frame at rest",
            "window, 5000 groups: at rest",
            "<= 16",
            "CPU-ms",
        ),
        _speed(
            "10M splats: build the level of detail",
            "10M: CPU to build the tree",
            "<= 60",
            "CPU-s",
            _LANDSCAPE,
        ),
        _speed(
            "a frame of 10M splats, to one of 1M",
            "10M: CPU of a frame, per that of 1M",
            "<= 1.3",
            "times",
            _LANDSCAPE,
        ),
        Row(
            "`gaga run` on 1,000 photos of 12 Mpx with poses, default options: peak memory",
            Data("drawn views of the demo scene", "no"),
            once=(2338,),
            unit="MiB",
        ),
        Row("program folder without models", Data("Linux", "–"), once=(351,), unit="MiB"),
        _speed(
            "30M splats: peak memory",
            "30M: peak of memory, textures included",
            "<= 8192",
            "MiB",
            _LANDSCAPE,
        ),
    ],
}


def with_tables(page: str, record: Record) -> str:
    """Return the page with the table under each heading made again from the record.

    Raises ``KeyError`` for a figure that is not in the record, ``ValueError`` for a heading that is
    not on the page.
    """
    values = {name: value for figures in record.values() for name, value in figures.items()}
    for heading, rows in TABLES.items():
        table = _HEAD + "".join(_line(row, values) for row in rows)
        place = re.compile(rf"(^## {re.escape(heading)}\n(?:(?!## |\|).*\n)*)(^\|.*\n)+", re.M)
        page, n = place.subn(lambda found, table=table: found[1] + table, page)  # type: ignore[misc]
        if n != 1:
            raise ValueError(f"{PAGE.name}: expected one table under {heading!r}, found {n}")
    return page


def other_bars(measured: Iterable[Figure]) -> list[str]:
    """Names of figures that are measured with another bar than their row has."""
    bars = {
        name: bar for rows in TABLES.values() for row in rows for name, bar in row.values if bar
    }
    return [f.name for f in measured if f.bar and bars.get(f.name, f.bar) != f.bar]


def _line(row: Row, values: Mapping[str, float]) -> str:
    figures = [Figure(name, values[name], row.unit, bar) for name, bar in row.values]
    shown = [_number(figure.value, row) for figure in figures] or [
        f"{value:,}" for value in row.once
    ]
    value = " / ".join(shown) + f" {row.unit}".rstrip() + " †" * bool(row.once)
    bar = " / ".join(_limit(figure, row) for figure in figures) if any(row.bars) else "–"
    return f"| {row.said} | {value} | {bar} | {row.on.said} | {row.on.used} |\n"


def _limit(figure: Figure, row: Row) -> str:
    if not figure.bar:
        return "–"
    sign, limit = figure.bar.split()
    said = f"{'≤' if sign == '<=' else '≥'} {float(f'{float(limit) * row.factor:.3g}'):,g}"
    return said if figure.holds else f"{said} **missed**"


def _number(value: float, row: Row) -> str:
    if row.factor == 100:
        return f"{100 * value:.1f}"
    return f"{float(f'{value:.3g}'):,.10g}" if abs(value) < 1e4 else f"{value:,.0f}"
