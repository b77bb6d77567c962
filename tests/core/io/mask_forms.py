"""The same true masks in every form that programs write, and the label maps they stand for."""

import csv
import json
from collections.abc import Callable, Mapping
from pathlib import Path

import numpy as np
from PIL import Image

from gaga_core.arrays import BoolArray, IntArray
from gaga_core.camera import Camera
from gaga_core.io.folder.scene_folder import SceneFolder
from gaga_core.io.masks.coco import compress_counts, encode_rle
from gaga_core.io.masks.label_maps import write_labels

H, W = 30, 40
NAMES = ("a.b.jpg", "frame_007.png", "frame_010.png")
Masks = list[tuple[BoolArray, float]]


def box(top: int, left: int, height: int, width: int) -> BoolArray:
    mask = np.zeros((H, W), np.bool_)
    mask[top : top + height, left : left + width] = True
    return mask


# Overlapping masks of each view: the more confident one lies on top.
SCORED: Mapping[str, Masks] = {
    "a.b": [(box(2, 2, 20, 20), 0.8), (box(5, 5, 6, 6), 0.95), (box(0, 30, 8, 8), 0.3)],
    "frame_007": [(box(1, 1, 10, 30), 0.9)],
    "frame_010": [(box(4, 4, 9, 9), 0.6), (box(4, 4, 20, 9), 0.7), (box(20, 20, 5, 5), 0.99)],
}


def flat(masks: Masks, *, scored: bool = True) -> IntArray:
    """The label map by hand: sure ones only, less confident (or larger) first; ids by rank."""
    kept = [(m, s if scored else 1.0) for m, s in masks if s >= 0.5 or not scored]
    kept.sort(key=lambda pair: (-pair[1], int(pair[0].sum())))
    labels = np.zeros((H, W), np.int32)
    for rank in range(len(kept), 0, -1):
        labels[kept[rank - 1][0]] = rank
    _, dense = np.unique(labels, return_inverse=True)  # a mask that is covered whole is dropped
    return dense.reshape(H, W).astype(np.int32) if 0 in labels else labels


TRUE = {stem: flat(masks) for stem, masks in SCORED.items()}
UNSCORED = {stem: flat(masks, scored=False) for stem, masks in SCORED.items()}


def scene(root: Path) -> SceneFolder:
    K = np.array([[50.0, 0, W / 2], [0, 50, H / 2], [0, 0, 1]])
    cameras = tuple(Camera(K, np.eye(4), W, H, name) for name in NAMES)
    return SceneFolder(root, None, cameras, {}, train=NAMES)


def rle(mask: BoolArray, *, compressed: bool) -> dict[str, object]:
    counts = encode_rle(mask)
    return {"size": [H, W], "counts": compress_counts(counts) if compressed else counts}


def sam_list(masks: Masks, *, compressed: bool = True) -> list[dict[str, object]]:
    """As SAM's SamAutomaticMaskGenerator gives it."""
    return [
        {
            "segmentation": rle(m, compressed=compressed),
            "area": int(m.sum()),
            "predicted_iou": s,
            "stability_score": 0.97,
        }
        for m, s in masks
    ]


def write(path: Path, content: object) -> None:
    path.parent.mkdir(parents=True, exist_ok=True)
    path.write_text(json.dumps(content))


def label_pngs(folder: Path) -> Mapping[str, IntArray]:
    for stem, labels in TRUE.items():
        folder.mkdir(exist_ok=True)
        Image.fromarray(labels.astype(np.uint8)).save(folder / f"{stem}.png")
    return TRUE


def sixteen_bits(folder: Path) -> Mapping[str, IntArray]:
    folder.mkdir()
    for stem, labels in TRUE.items():
        write_labels(folder / f"{stem}.png", labels * 300)
    return {stem: labels * 300 for stem, labels in TRUE.items()}


def rgb_coded(folder: Path) -> Mapping[str, IntArray]:
    """Every id a color, ascending."""
    colors = np.array([[0, 0, 0], [0, 9, 200], [7, 1, 3], [255, 0, 0], [255, 0, 9]], np.uint8)
    folder.mkdir()
    for stem, labels in TRUE.items():
        Image.fromarray(colors[labels]).save(folder / f"{stem}.png")
    return TRUE


def palette(folder: Path) -> Mapping[str, IntArray]:
    folder.mkdir()
    for stem, labels in TRUE.items():
        image = Image.fromarray(labels.astype(np.uint8)).convert("P")
        image = Image.frombytes("P", (W, H), labels.astype(np.uint8).tobytes())
        image.putpalette([255, 255, 255, 0, 255, 0, 0, 0, 0] * 3)
        image.save(folder / f"{stem}.png")
    return TRUE


def gaga_raw(folder: Path) -> Mapping[str, IntArray]:
    """A scene of Gaga: its script cuts names at the first dot and writes the raw masks so."""
    raw = folder / "raw_sam_mask"
    raw.mkdir(parents=True)
    (folder / "images").mkdir()
    for stem, labels in TRUE.items():
        Image.fromarray(labels.astype(np.uint8)).save(raw / f"{stem.split('.')[0]}.png")
    return TRUE


def sam_json(folder: Path) -> Mapping[str, IntArray]:
    for stem, masks in SCORED.items():
        write(folder / f"{stem}.json", sam_list(masks))
    return TRUE


def sam_json_plain(folder: Path) -> Mapping[str, IntArray]:
    for stem, masks in SCORED.items():
        write(folder / f"{stem}.json", sam_list(masks, compressed=False))
    return TRUE


def sa1b(folder: Path) -> Mapping[str, IntArray]:
    for i, (stem, masks) in enumerate(SCORED.items()):
        image = {"image_id": i, "width": W, "height": H, "file_name": f"{stem}.jpg"}
        write(folder / f"{stem}.json", {"image": image, "annotations": sam_list(masks)})
    return TRUE


def npz(folder: Path) -> Mapping[str, IntArray]:
    folder.mkdir()
    for stem, masks in SCORED.items():
        stack, scores = np.stack([m for m, _ in masks]), np.array([s for _, s in masks])
        np.savez_compressed(folder / f"{stem}.npz", masks=stack, scores=scores)
    return TRUE


def npy(folder: Path) -> Mapping[str, IntArray]:
    folder.mkdir()
    for stem, masks in SCORED.items():
        np.save(folder / f"{stem}.npy", np.stack([m for m, _ in masks]).astype(np.uint8))
    return UNSCORED


def npy_labels(folder: Path) -> Mapping[str, IntArray]:
    folder.mkdir()
    for stem, labels in TRUE.items():
        np.save(folder / f"{stem}.npy", np.where(labels == 0, -1, labels))
    return TRUE


def coco(file: Path) -> Mapping[str, IntArray]:
    """A data set: run lengths, and a polygon where the mask is a box."""
    images, annotations = [], []
    for i, (stem, masks) in enumerate(SCORED.items()):
        images.append({"id": 7 * i, "file_name": f"sub/{stem}.jpg", "height": H, "width": W})
        for mask, score in masks:
            y, x = np.argwhere(mask).min(0).tolist()
            y1, x1 = (np.argwhere(mask).max(0) + 1).tolist()
            polygon = [[x, y, x1, y, x1, y1, x, y1]]
            form: object = polygon if i == 1 else rle(mask, compressed=i == 0)
            annotations.append({"image_id": 7 * i, "segmentation": form, "score": score})
    write(file, {"images": images, "annotations": annotations, "categories": []})
    return TRUE


def coco_results(file: Path) -> Mapping[str, IntArray]:
    entries = [
        {
            "image_id": stem,
            "category_id": 1,
            "score": score,
            "segmentation": rle(m, compressed=True),
        }
        for stem, masks in SCORED.items()
        for m, score in masks
    ]
    write(file, entries)
    return TRUE


def mask_folders(folder: Path) -> Mapping[str, IntArray]:
    """As SAM's command line writes them: masks 0.png, 1.png, ... and a table of scores."""
    for stem, masks in SCORED.items():
        (folder / stem).mkdir(parents=True)
        with (folder / stem / "metadata.csv").open("w", newline="") as file:
            table = csv.writer(file)
            table.writerow(["id", "area", "predicted_iou"])
            for i, (mask, score) in enumerate(masks):
                image = Image.fromarray(mask.astype(np.uint8) * np.uint8(255))
                image.save(folder / stem / f"{i}.png")
                table.writerow([i, int(mask.sum()), score])
    return TRUE


def bare_mask_folders(folder: Path) -> Mapping[str, IntArray]:
    mask_folders(folder)
    for stem in SCORED:
        (folder / stem / "metadata.csv").unlink()
    return UNSCORED


FORMS: Mapping[str, tuple[Callable[[Path], Mapping[str, IntArray]], str]] = {
    "labels": (label_pngs, r"3 label maps \(8-bit gray\)"),
    "16 bit": (sixteen_bits, r"3 label maps \(16-bit gray\)"),
    "rgb": (rgb_coded, r"3 label maps \(RGB-coded\)"),
    "palette": (palette, r"3 label maps \(palette\)"),
    "gaga raw": (gaga_raw, r"3 label maps of Gaga's sam masks, not associated yet"),
    "sam json": (sam_json, "3 JSON lists of masks, one a picture"),
    "sam json, plain counts": (sam_json_plain, "3 JSON lists of masks, one a picture"),
    "sa-1b": (sa1b, "3 JSON lists of masks, one a picture"),
    "npz": (npz, "3 numpy files with lists of masks"),
    "npy": (npy, "3 numpy files with lists of masks"),
    "npy labels": (npy_labels, "3 numpy files with label maps"),
    "coco.json": (coco, "A COCO file with the masks of 3 pictures"),
    "results.json": (coco_results, "COCO results with masks of 3 pictures"),
    "mask folders": (mask_folders, "3 folders of one binary mask a file with SAM's metadata.csv"),
    "bare mask folders": (bare_mask_folders, "3 folders of one binary mask a file in"),
}
