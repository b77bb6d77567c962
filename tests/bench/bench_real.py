"""The real scene ycb_table: 15 scanned objects, 56 views with masks, 8 held out.

Empty where the scene is not on the machine (GAGA_TEST_DATA names the folder of real scenes).
"""

import tempfile
from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path

import numpy as np

from gaga_core.evaluate.compare import compare_variants
from gaga_core.evaluate.group_scores import Score, score_pairs
from gaga_core.evaluate.published import iou_drop
from gaga_core.evaluate.settings import CompareConfig
from gaga_core.grouping.associate import AssociateConfig
from gaga_core.identity.lift import Mode
from gaga_core.io.folder.scene_folder import SceneFolder, open_scene_folder, read_model
from gaga_core.io.masks.label_maps import read_labels
from gaga_core.pipeline.associate import associate_scene
from gaga_core.pipeline.lift import lift_scene
from gaga_core.pipeline.render import render_views
from gaga_core.progress import run_stage
from tests.bench.figures import Figure, data_folder

_FEW = 0.05  # share of the views
_BARS = {"iou": ">= 0.9", "precision": ">= 0.8", "recall": ">= 1"}


def figures() -> list[Figure]:
    """Held-out scores, void left out, of both presets, and what the identities decode to."""
    root = data_folder("ycb_table")
    if not root.is_dir():
        return []
    found = []
    with tempfile.TemporaryDirectory() as name:
        # The same scene with its results elsewhere: real data stays as it is.
        folder = replace(open_scene_folder(root), root=Path(name))
        gaussians = run_stage(read_model(folder))
        for preset in ("paper", "robust"):
            config = AssociateConfig.of(preset)
            run_stage(associate_scene(folder, "sim", config, gaussians=gaussians))
            files = run_stage(render_views(folder, gaussians=gaussians))
            score = _score(root, files)
            for key, bar in _BARS.items():
                limit = bar if preset == "robust" else ""
                found.append(Figure(f"ycb_table: {preset}, {key}", getattr(score, key), "", limit))
        vote, refine = (_lifted(root, folder, mode) for mode in ("vote", "refine"))
        few = _few_views(root, folder)
    return [
        *found,
        *few,
        Figure("ycb_table: IoU of the identities, vote", vote, ""),
        Figure("ycb_table: IoU of the identities, refine", refine, ""),
    ]


def _few_views(root: Path, folder: SceneFolder) -> list[Figure]:
    """What 5 % of the views cost in IoU: three draws of 3 of 56 views."""
    config = CompareConfig(("paper", "robust"), ("paper", "robust"), (_FEW,), (0, 1, 2), "none")
    table = run_stage(compare_variants(folder, root / "gt" / "instance", "sim", config))
    drops = {}
    for preset in config.sparse:
        rows = [row for row in table.rows if row.variant == preset]
        whole = next(row.without_void.iou for row in rows if row.share == 1.0)
        few = np.mean([row.without_void.iou for row in rows if row.share == _FEW])
        drops[preset] = 100 * iou_drop(whole, float(few))
    limit = f"<= {drops['paper']:.3g}"
    return [
        Figure("ycb_table, 5 % of the views: IoU drop, paper", drops["paper"], "%"),
        Figure("ycb_table, 5 % of the views: IoU drop, robust", drops["robust"], "%", limit),
    ]


def _lifted(root: Path, folder: SceneFolder, mode: Mode) -> float:
    run_stage(lift_scene(folder, mode))
    return _score(root, run_stage(render_views(folder, what="identity"))).iou


def _score(root: Path, files: Sequence[Path]) -> Score:
    truth = root / "gt" / "instance"
    return score_pairs([(read_labels(truth / path.name), read_labels(path)) for path in files])[1]
