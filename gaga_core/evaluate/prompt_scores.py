"""Scores of binary object masks (LERF-Mask): mean IoU and mean boundary IoU.

Layout of both folders, as the data set has it: ``<view>/<text prompt>.png``, set where above 128.
IoU is averaged over the views of a prompt, then over prompts. Boundary IoU compares only the band
along each mask's outline (Cheng et al., CVPR 2021, with the band of Gaussian Grouping's script:
2 % of the picture's diagonal). Two differences from that script, which inflate it: a missing
prediction is 0 here, not skipped, and two empty masks agree (1), where it has 0/0.
"""

from collections.abc import Iterable
from dataclasses import asdict, dataclass
from pathlib import Path

import numpy as np
from scipy.ndimage import minimum_filter

from gaga_core.arrays import BoolArray
from gaga_core.errors import GagaError
from gaga_core.io.images import IMAGE_SUFFIXES, read_rgb
from gaga_core.masks import resize_labels
from gaga_core.progress import Progress, Stage, run_stage

BAND = 0.02  # width of the boundary band, share of the diagonal
_SET = 128  # gray values above are inside


@dataclass(frozen=True)
class PromptScore:
    """One text prompt, averaged over the views that have a true mask of it."""

    prompt: str
    iou: float
    boundary_iou: float
    n_views: int


@dataclass(frozen=True)
class LerfMaskReport:
    """Both means, the prompts behind them, and what did not match."""

    miou: float
    mean_boundary_iou: float
    prompts: tuple[PromptScore, ...]  # by name
    missing: tuple[str, ...]  # "view/prompt" without a prediction: scored as 0
    unused: tuple[str, ...]  # predictions "view/prompt" that no true mask asks for

    def to_json(self) -> dict[str, object]:
        """Plain values."""
        return asdict(self)

    def table(self) -> list[list[str]]:
        """Rows of text, headings first."""
        rows = [["prompt", "IoU", "boundary IoU", "views"]]
        for p in self.prompts:
            rows.append([p.prompt, *_percents(p.iou, p.boundary_iou), str(p.n_views)])
        n_views = str(sum(p.n_views for p in self.prompts))
        return [*rows, ["mean", *_percents(self.miou, self.mean_boundary_iou), n_views]]


def evaluate_lerf_mask(
    pred: Path, gt: Path, *, views: Iterable[str] | None = None
) -> LerfMaskReport:
    """Score the masks ``pred/<view>/<prompt>.png`` against ``gt/<view>/<prompt>.png``.

    Every true mask counts (or only those of ``views``, folder names). A missing prediction is 0 and
    named. A prediction of another size is resized (nearest). Raises ``GagaError`` without truth.
    """
    return run_stage(lerf_mask_stage(pred, gt, views=views))


def lerf_mask_stage(
    pred: Path, gt: Path, *, views: Iterable[str] | None = None
) -> Stage[LerfMaskReport]:
    """`evaluate_lerf_mask` with a step of progress a true mask."""
    true_files = _list_masks(gt)
    if views is not None:
        wanted = set(views)
        true_files = {key: path for key, path in true_files.items() if key[0] in wanted}
    if not true_files:
        raise GagaError(f"{gt} holds no masks <view>/<prompt>.png. Choose another folder.")
    predicted_files = _list_masks(pred)
    by_prompt: dict[str, list[tuple[float, float]]] = {}
    for i, ((view, prompt), path) in enumerate(true_files.items()):
        yield Progress("Score", i, len(true_files), f"{view}/{prompt}")
        scores = (0.0, 0.0)
        if (view, prompt) in predicted_files:
            true = _read_mask(path)
            predicted = _read_mask(predicted_files[view, prompt])
            if predicted.shape != true.shape:
                ids = resize_labels(predicted.astype(np.int32), true.shape[1], true.shape[0])
                predicted = ids.astype(np.bool_)
            scores = mask_iou(predicted, true), boundary_iou(predicted, true)
        by_prompt.setdefault(prompt, []).append(scores)
    means = {name: np.mean(scores, axis=0) for name, scores in sorted(by_prompt.items())}
    prompts = tuple(
        PromptScore(name, float(iou), float(boundary), len(by_prompt[name]))
        for name, (iou, boundary) in means.items()
    )
    seen_views = {view for view, _ in true_files}
    missing = [key for key in true_files if key not in predicted_files]
    unused = [key for key in predicted_files if key not in true_files and key[0] in seen_views]
    return LerfMaskReport(
        miou=float(np.mean([p.iou for p in prompts])),
        mean_boundary_iou=float(np.mean([p.boundary_iou for p in prompts])),
        prompts=prompts,
        missing=tuple("/".join(key) for key in missing),
        unused=tuple("/".join(key) for key in unused),
    )


def mask_iou(a: BoolArray, b: BoolArray) -> float:
    """IoU of two masks (H, W); two empty ones agree: 1."""
    union = int((a | b).sum())
    return float((a & b).sum() / union) if union else 1.0


def boundary_iou(a: BoolArray, b: BoolArray) -> float:
    """IoU of the boundary bands of two masks (H, W); two empty ones agree: 1."""
    return mask_iou(boundary_of(a), boundary_of(b))


def boundary_of(mask: BoolArray) -> BoolArray:
    """Pixels (H, W) of ``mask`` within `BAND` of its outline; the picture's edge is outline too.

    The same as eroding with a 3 x 3 square d times and taking the difference, d = max(1, round(2 %
    of the diagonal)): one square of side 2 d + 1.
    """
    d = max(1, round(BAND * float(np.hypot(*mask.shape))))
    eroded = minimum_filter(mask.view(np.uint8), size=2 * d + 1, mode="constant", cval=0)
    return mask & (eroded == 0)


def _percents(*values: float) -> list[str]:
    return [f"{100 * value:.1f}" for value in values]


def _list_masks(folder: Path) -> dict[tuple[str, str], Path]:
    """Files by (view, prompt), in that order."""
    if not folder.is_dir():
        raise GagaError(f"{folder} is not a folder. Choose a folder of <view>/<prompt>.png masks.")
    found = sorted(p for p in folder.glob("*/*") if p.suffix.lower() in IMAGE_SUFFIXES)
    return {(p.parent.name, p.stem): p for p in found if not p.name.startswith(".")}


def _read_mask(path: Path) -> BoolArray:
    mask: BoolArray = read_rgb(path).max(axis=2) > _SET
    return np.ascontiguousarray(mask)
