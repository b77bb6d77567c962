"""Results of a data set, scene by scene, as the tables that the paper prints."""

from collections.abc import Callable, Mapping, Sequence
from dataclasses import asdict, dataclass, field, replace

import numpy as np

from gaga_core.evaluate.group_scores import VOID_LEFT_OUT, Score
from gaga_core.evaluate.published import (
    INSTANCE,
    INSTANCE_METRICS,
    PROMPT_METRICS,
    PROMPTS,
    SPARSE_IOU,
    THRESHOLD_MIOU,
    Conditions,
    absent_scenes,
    departures,
    drop_start,
    iou_drop,
    published_drop,
    sentences,
)
from gaga_core.io.datasets import DATASETS


@dataclass(frozen=True)
class PromptScores:
    """Mean IoU and mean boundary IoU of text prompts, in 0..1."""

    miou: float
    mean_boundary_iou: float
    by_prompt: Mapping[str, tuple[float, float]] = field(default_factory=dict)


_VOID_COUNTS = "Counted: void is a label, and every id is a prediction (the published code)."


@dataclass(frozen=True)
class InstanceScores:
    """Algorithm 1 under both countings."""

    with_void: Score
    without_void: Score


@dataclass(frozen=True)
class BenchmarkRun:
    """One run over one scene: all train views, or a share of them."""

    share: float
    scores: InstanceScores | PromptScores | None  # None: shown, not scored
    n_views: int  # train views used
    n_groups: int
    seconds: float
    missing: tuple[str, ...] = ()  # predictions that were not there: scored as 0
    notes: tuple[str, ...] = ()  # sentences for people

    @property
    def headline(self) -> float:
        """The data set's IoU in 0..1, with void where the published code counts it; 0 where nothing
        is scored."""
        if self.scores is None:
            return 0.0
        if isinstance(self.scores, PromptScores):
            return self.scores.miou
        return self.scores.with_void.iou


@dataclass(frozen=True)
class SceneResult:
    """All runs over one scene, the one with all train views first."""

    scene: str
    masks: str  # where the 2D masks come from
    runs: tuple[BenchmarkRun, ...]
    n_reused: int = 0  # runs taken from an earlier benchmark
    conditions: Conditions = field(default_factory=Conditions)

    def run(self, share: float) -> BenchmarkRun | None:
        """The run with this share of the train views."""
        return next((run for run in self.runs if run.share == share), None)


@dataclass(frozen=True)
class TextTable:
    """Rows of text, headings first."""

    rows: tuple[tuple[str, ...], ...]
    notes: tuple[str, ...] = ()  # how it was made, sentences

    def table(self) -> list[list[str]]:
        """The rows."""
        return [list(row) for row in self.rows]

    def to_json(self) -> dict[str, object]:
        """Plain values."""
        return asdict(self)


@dataclass(frozen=True)
class BenchmarkReport:
    """A data set's results next to the published ones."""

    dataset: str  # "replica"
    title: str  # "Replica"
    preset: str
    scenes: tuple[SceneResult, ...]
    failed: Mapping[str, str]  # scene -> why it has no result
    out: str  # folder of the results
    protocol: str = "instance"  # "lerf-mask", "3d-ovs", "qualitative"
    sparse_splats: str = ""  # which splats runs over few views use
    is_retrained: bool = False  # they were trained on those views alone, as published
    is_further: bool = False  # of scenes that no published figure is a mean over
    changes: str = ""  # settings of the association that are not the preset's
    threshold: float | None = None  # of overlap, where it is one of them

    def to_json(self) -> dict[str, object]:
        """Plain values; scores in 0..1, published figures in percent."""
        values = asdict(self)
        values["means"] = {
            str(share): self._mean_of(scored, share)
            for share in self._shares()
            if (scored := self.parts()[0]._scored(share))
        }
        values["tables"] = [table.table() for table in self.tables()]
        values["made"] = self.made()
        values["departures"] = self.departures()
        return values

    def made(self) -> list[str]:
        """Conditions of the tables: split, truth, masks, scenes, splats, queries."""
        of_scenes = [(s.scene, s.conditions) for s in self.scenes]
        return sentences(self.dataset, of_scenes, is_further=self.is_further)

    def parts(self) -> tuple["BenchmarkReport", ...]:
        """The scenes of the published means, then those that the data set has besides, if any."""
        known = DATASETS[self.dataset].scenes
        further = tuple(scene for scene in self.scenes if scene.scene not in known)
        if not known or not further or len(further) == len(self.scenes):
            return (self,)
        own = tuple(scene for scene in self.scenes if scene.scene in known)
        failed = {scene: why for scene, why in self.failed.items() if scene not in known}
        mine = {scene: why for scene, why in self.failed.items() if scene in known}
        title = f"{self.title}, further scenes"
        more = replace(self, scenes=further, failed=failed, title=title, is_further=True)
        return (replace(self, scenes=own, failed=mine), more)

    def departures(self) -> list[str]:
        """Differences from the paper; where there are any, its figures are in a separate table."""
        if self.is_further:
            return []
        found = [d for s in self.scenes for d in departures(self.dataset, s.scene, s.conditions)]
        absent = absent_scenes(self.dataset, [s.scene for s in self.scenes])
        if absent and self.protocol == "instance":
            n = len(absent) + sum(s.scene not in absent for s in self.scenes)
            found.append(f"scenes: {len(absent)} of {n} are not here, and the mean is over all")
        if self.changes and not self._at_threshold():
            found.append(f"settings: {self.changes}")
        return list(dict.fromkeys(found))

    def _at_threshold(self) -> Mapping[str, tuple[float, ...]]:
        """Published mIoU by scene where only the overlap threshold was changed; mBIoU is not."""
        if self.dataset != "lerf-mask" or self.changes != f"threshold {self.threshold}":
            return {}
        return {s: (v,) for s, v in THRESHOLD_MIOU.get(self.threshold or 0.0, {}).items()}

    def _departs(self) -> bool:
        """Whether the published figures may not stand next to ours."""
        return self.is_further or bool(self.departures())

    def sentences(self) -> list[str]:
        """Notes on the table."""
        found = [f"{scene}: {reason}" for scene, reason in self.failed.items()]
        for scene in self.scenes:
            whole = scene.runs[0]
            found += [f"{scene.scene}: {note}" for note in whole.notes]
            if whole.missing:
                found.append(
                    f"{scene.scene}: {len(whole.missing)} predictions are missing and count as 0 "
                    f"({_listed(whole.missing)})."
                )
        reused = sum(scene.n_reused for scene in self.scenes)
        if reused:
            found.append(f"{reused} runs were finished before (--redo runs them again).")
        return found

    def tables(self) -> tuple[TextTable, ...]:
        """The paper's table with ours in it, the scores without void, and the table of few views
        if any was run; the same for further scenes, without published figures."""
        return tuple(table for part in self.parts() for table in part._tables())

    def _tables(self) -> tuple[TextTable, ...]:
        whole = [(s.scene, run) for s in self.scenes if (run := s.run(1.0)) is not None]
        scored = [(scene, run) for scene, run in whole if run.scores is not None]
        instance = self.protocol in ("instance", "qualitative")
        tables = []
        if scored or not whole:
            tables.append(self._instance_table(scored) if instance else self._prompt_table(scored))
        if instance and scored:
            tables.append(self._void_free_table(scored))
        if len(self._shares()) > 1 and scored:
            tables.append(self._sparse_table())
        if scored != whole:
            tables.append(self._shown_table(whole))
        made = self.made()
        noted = [replace(table, notes=(*table.notes, *made)) for table in tables]
        return (*noted, *self._published_apart())

    def _shown_table(self, whole: Sequence[tuple[str, BenchmarkRun]]) -> TextTable:
        """Scenes that have no truth."""
        rows = [
            [scene, str(run.n_views), str(run.n_groups), f"{run.seconds:.1f}"]
            for scene, run in whole
            if run.scores is None
        ]
        return _table(
            [[f"{self.title}, {self.preset}: shown", "views", "groups", "seconds"], *rows]
        )

    def _published_apart(self) -> tuple[TextTable, ...]:
        """The published figures on their own, where ours were not measured the same way."""
        why = self.departures()
        if not why:
            return ()
        rows = [
            [f"{p.method}, {p.masks}", *_hundredths(p.values)]
            for p in INSTANCE.get(self.dataset, ())
        ]
        names = list(INSTANCE_METRICS)
        if self.dataset in PROMPTS:
            n = 1 if self.protocol == "3d-ovs" else 2
            names = list(PROMPT_METRICS[:n])
            figures = self._at_threshold() or PROMPTS[self.dataset]
            rows = [[scene, *_tenths(v, len(v))] for scene, v in figures.items()]
            names = names[: len(rows[0]) - 1]
        head = f"{self.title}, published: measured in another way than ours"
        return (_table([[head, *names], *rows], *(f"Not as published: {r}." for r in why)),)

    def _instance_table(self, whole: Sequence[tuple[str, BenchmarkRun]]) -> TextTable:
        """Counted as published: void is a label of both sides."""

        def figures(run: BenchmarkRun) -> Sequence[float]:
            return (*_instance_figures(run, with_void=True)[:3], run.n_groups, run.seconds)

        names = ("IoU", "P", "R", "groups", "seconds", "missing")
        rows = [
            [head, *_hundredths(values[:3]), f"{values[3]:.0f}", f"{values[4]:.1f}", str(n)]
            for head, values, n in self._with_mean(whole, figures)
        ]
        rows[len(whole) : len(whole)] = [[s, *[""] * 5, "failed"] for s in self.failed]
        for p in () if self._departs() else INSTANCE.get(self.dataset, ()):
            title = f"published ({p.table}): {p.method}, {p.masks}"
            rows.append([title, *_hundredths(p.values), "", "", ""])
        return _table([[f"{self.title}, {self.preset}", *names], *rows], _VOID_COUNTS)

    def _void_free_table(self, whole: Sequence[tuple[str, BenchmarkRun]]) -> TextTable:
        """The same without pixels of true label 0."""
        found = self._with_mean(whole, lambda run: _instance_figures(run, with_void=False))
        rows = [[head, *_hundredths(values)] for head, values, _ in found]
        return _table([["void left out", "IoU", "P", "R", "pooled IoU"], *rows], VOID_LEFT_OUT)

    def _prompt_table(self, whole: Sequence[tuple[str, BenchmarkRun]]) -> TextTable:
        """Ours, next to the published figures where both were measured the same way."""
        names = PROMPT_METRICS[: 1 if self.protocol == "3d-ovs" else 2]
        n, departs = len(names), self._departs()
        published = {} if departs else self._at_threshold() or PROMPTS.get(self.dataset, {})
        columns = [] if departs else [f"published {name}" for name in names]

        def theirs(values: Sequence[float]) -> list[str]:
            shown = [] if departs else _tenths(values, n)
            return shown + [""] * (len(columns) - len(shown))

        # Means over the same scenes: a published one counts where ours does.
        known = [published[scene] for scene, _ in whole if scene in published]
        mean = np.mean(known, axis=0).tolist() if known else ()
        shown = [*(published.get(scene, ()) for scene, _ in whole), mean]
        found = self._with_mean(whole, lambda run: _prompt_figures(run)[:n])
        rows = [
            [head, *_tenths(values, n), *theirs(of_paper), str(missing)]
            for (head, values, missing), of_paper in zip(found, shown, strict=False)
        ]
        rows[len(whole) : len(whole)] = [
            [scene, *_tenths((), n), *theirs(published.get(scene, ())), "failed"]
            for scene in self.failed
        ]
        return _table([[f"{self.title}, {self.preset}", *names, *columns, "missing"], *rows])

    def _with_mean(
        self,
        runs: Sequence[tuple[str, BenchmarkRun]],
        figures: Callable[[BenchmarkRun], Sequence[float]],
    ) -> list[tuple[str, Sequence[float], int]]:
        """Head, figures and missing predictions of each scene, then of all, if there is any."""
        rows = [(scene, figures(run), len(run.missing)) for scene, run in runs]
        if rows:
            mean = np.mean([values for _, values, _ in rows], axis=0).tolist()
            rows.append((self._mean_title(len(rows)), mean, sum(n for *_, n in rows)))
        return rows

    def _sparse_table(self) -> TextTable:
        is_alike = self.is_retrained and not self._departs()
        published = SPARSE_IOU.get(self.dataset, {}) if is_alike else {}
        heads = ["train views", "scenes", "IoU", "IoU drop"]
        for masks in published:
            heads += [f"published, {masks}", "drop"]
        rows = []
        notes = [self.sparse_splats]
        if published:
            starts = ", ".join(f"{masks} {drop_start(masks):.2f}" for masks in published)
            notes.append(
                f"Published drops are as the paper prints them, from its IoU of ScanNet ({starts})."
            )
        elif self.dataset in SPARSE_IOU and not self._departs():
            notes.append("The published figures are of splats of those views (--retrain-sparse).")
        for share in self._shares():
            whole_too = self._scored(1.0)
            both = [scene for scene in self._scored(share) if scene in whole_too]
            iou, whole = self._mean_of(both, share), self._mean_of(both, 1.0)
            row = [f"{share:.0%}", str(len(both)), f"{100 * iou:.2f}", _drop(whole, iou, share)]
            for masks, figures in published.items():
                theirs = figures.get(share)
                if theirs is None:
                    row += ["", ""]
                else:
                    drop = 100 * published_drop(self.dataset, masks, share)
                    row += [f"{theirs:.2f}", "" if share == 1.0 else f"{drop:.2f} %"]
            rows.append(row)
        counted = () if self.protocol in ("lerf-mask", "3d-ovs") else (_VOID_COUNTS,)
        return _table([heads, *rows], *counted, *notes)

    def _shares(self) -> list[float]:
        found = {run.share for scene in self.scenes for run in scene.runs}
        return sorted(found, reverse=True)

    def _scored(self, share: float) -> list[SceneResult]:
        """The scenes that have scores of a run with this share of the train views."""
        runs = [(scene, scene.run(share)) for scene in self.scenes]
        return [scene for scene, run in runs if run is not None and run.scores is not None]

    @staticmethod
    def _mean_of(scenes: Sequence[SceneResult], share: float) -> float:
        found = [run.headline for scene in scenes if (run := scene.run(share)) is not None]
        return float(np.mean(found)) if found else 0.0

    def _mean_title(self, n: int) -> str:
        total = len(self.scenes) + len(self.failed)
        plural = "scene" if total == 1 else "scenes"
        return f"mean of {n} {plural}" if n == total else f"mean of {n} of {total} {plural}"


def _instance_figures(run: BenchmarkRun, *, with_void: bool) -> list[float]:
    """Percent: IoU, precision, recall, pooled IoU."""
    if run.scores is None or isinstance(run.scores, PromptScores):
        return []
    score = run.scores.with_void if with_void else run.scores.without_void
    values = (score.iou, score.precision, score.recall, score.pooled_iou)
    return [100 * value for value in values]


def _prompt_figures(run: BenchmarkRun) -> list[float]:
    """Percent: IoU, boundary IoU."""
    assert isinstance(run.scores, PromptScores)
    return [100 * run.scores.miou, 100 * run.scores.mean_boundary_iou]


def _hundredths(values: Sequence[float]) -> list[str]:
    return [f"{value:.2f}" for value in values]


def _listed(names: Sequence[str], most: int = 5) -> str:
    more = f" and {len(names) - most} more" if len(names) > most else ""
    return ", ".join(names[:most]) + more


def _tenths(values: Sequence[float], n: int) -> list[str]:
    return [f"{value:.1f}" for value in values] or [""] * n


def _drop(whole: float, sparse: float, share: float) -> str:
    return "" if share == 1.0 else f"{100 * iou_drop(whole, sparse):.1f} %"


def _table(rows: Sequence[Sequence[str]], *notes: str) -> TextTable:
    return TextTable(tuple(tuple(row) for row in rows), notes)
