"""From text prompts to masks: the groups that a phrase means, cut out of the views' group maps."""

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from PIL import Image

from gaga_core.arrays import BoolArray
from gaga_core.camera import Camera
from gaga_core.evaluate.published import PUBLISHED_RULE
from gaga_core.evaluate.settings import FindConfig
from gaga_core.grouping.votes import VOID_BELOW
from gaga_core.identity.field import IdentityField
from gaga_core.io.datasets import PromptTruth
from gaga_core.io.folder.staging import publish_all, staging_folder
from gaga_core.io.masks.label_maps import read_labels
from gaga_core.pipeline.search import Pictures, find_in_view, index_scene, search
from gaga_core.progress import Progress, Stage
from gaga_core.query.detector import CONTAINED, DetectConfig, contained, load_detector
from gaga_core.query.embed import load_embedder
from gaga_core.query.index import TextVectors
from gaga_core.raster.base import Rasterizer
from gaga_core.scene.scene import Scene

STAGE = "Find prompts"
TEXT_THRESHOLD = 0.45  # of a word in a box (Gaussian Grouping's script)
PROBABLE = 0.2  # probability of a group above which a pixel is its (likewise)


@dataclass(frozen=True, eq=False)
class Question:
    """Input of a method that answers text prompts."""

    scene: Scene  # the splats with their groups
    train: tuple[Camera, ...]
    views: tuple[Camera, ...]  # the views to answer for; the published protocol uses the first
    maps: Mapping[str, Path]  # group maps of those views, by view name
    rasterizer: Rasterizer
    field: IdentityField | None = None  # what the maps were decoded from; None: splatted groups


Answers = Mapping[str, Sequence[int]]  # phrase -> group ids; without an entry: not answered
Find = Callable[[Question, Sequence[str]], Stage[Answers]]


def find_by(config: FindConfig) -> Find:
    """The way of answering."""
    if config.detector is None:
        return by_words(config.embedder)
    if config.segmenter is None:
        return by_detector(config.detector)
    return by_published_rule(config.detector, config.segmenter)


def words_of(config: FindConfig) -> str:
    """The way of answering, for tables."""
    if config.detector is None:
        return "words alone" if config.embedder is None else "an index of pictures"
    if config.segmenter is None:
        return "boxes of a detector, groups by area"
    return f"{PUBLISHED_RULE}, share inside over {CONTAINED}, probability over {PROBABLE}"


def by_published_rule(detector_folder: Path, segmenter: str) -> Find:
    """Boxes in the rendered first view -> masks of Segment Anything in them, summed -> groups of
    which more than 0.7 lies inside (Ye et al., ECCV 2024, with its thresholds)."""

    def find(question: Question, phrases: Sequence[str]) -> Stage[Answers]:
        from gaga_core.segmentation.choose import prompter_named

        path = Path(segmenter)
        name, weights = (path.stem, path) if path.exists() else (segmenter, None)
        detector, prompter = load_detector(detector_folder), prompter_named(name, weights=weights)
        camera, answers = question.views[0], {}
        image = question.rasterizer.render(question.scene.gaussians, camera).image
        picture = np.ascontiguousarray((np.clip(image, 0, 1) * 255).astype(np.uint8))
        groups = read_labels(question.maps[camera.name])
        config = DetectConfig(text_threshold=TEXT_THRESHOLD)
        for i, phrase in enumerate(phrases):
            yield Progress(STAGE, i, len(phrases), phrase)
            boxes = detector.detect(picture, phrase, config)
            masks = prompter.in_boxes(picture, boxes.corners)
            inside: BoolArray = np.logical_or.reduce(masks, axis=0)
            answers[phrase] = contained(groups, inside).tolist()
        return answers

    return find


def by_detector(folder: Path) -> Find:
    """Boxes in the rendered first view -> groups by area (section 6 of the paper)."""

    def find(question: Question, phrases: Sequence[str]) -> Stage[Answers]:
        detector, view, engine = load_detector(folder), question.views[:1], question.rasterizer
        answers = {}
        for i, phrase in enumerate(phrases):
            yield Progress(STAGE, i, len(phrases), phrase)
            stage = find_in_view(question.scene, view, phrase, detector, rasterizer=engine)
            answer = yield from stage
            answers[phrase] = answer.groups[: answer.n_meant].tolist()
        return answers

    return find


def by_words(embedder: Path | None = None) -> Find:
    """What the search box finds: colors, sizes and places, and nouns through an index if given."""

    def find(question: Question, phrases: Sequence[str]) -> Stage[Answers]:
        scene, train, pictures = question.scene, question.train, None
        if embedder is not None:
            model = load_embedder(embedder)
            index = yield from index_scene(scene, train, model, rasterizer=question.rasterizer)
            pictures = Pictures(index, TextVectors(index.model, lambda: model))
        answers = {}
        for i, phrase in enumerate(phrases):
            yield Progress(STAGE, i, len(phrases), phrase)
            first = question.views[0]
            answer = search(scene, phrase, cameras=train, camera=first, pictures=pictures)
            # With an index the best group is an answer, however unsure; words alone may fail.
            n = answer.n_meant if pictures is None else max(1, answer.n_meant)
            answers[phrase] = answer.groups[:n].tolist()
        return answers

    return find


def answer_prompts(question: Question, prompts: PromptTruth, out: Path, find: Find) -> Stage[Path]:
    """Masks ``out/prompts/<key>/<text prompt>.png`` (0 or 255) of every prompt in every view.

    Where there are identities, a pixel belongs to a prompt when one of its groups has a
    probability over 0.2 (the published rule); else by its group. A prompt that ``find`` has no
    answer to gets no file, so that it is scored as missing.
    """
    answers = yield from find(question, prompts.prompts)
    cameras = {camera.name: camera for camera in question.views}
    with staging_folder(out) as staging:
        (staging / "prompts").mkdir()
        for i, (key, name) in enumerate(prompts.views.items()):
            yield Progress(STAGE, i, len(prompts.views), name)
            if name not in question.maps:
                continue
            inside = _inside(question, cameras[name])
            (staging / "prompts" / key).mkdir()
            for phrase in prompts.prompts:
                ids = list(answers.get(phrase, ()))
                if ids:
                    mask = inside(ids).astype(np.uint8) * np.uint8(255)
                    Image.fromarray(mask).save(staging / "prompts" / key / f"{phrase}.png")
        publish_all(staging, ["prompts"], out)
    return out / "prompts"


def _inside(question: Question, camera: Camera) -> Callable[[list[int]], BoolArray]:
    """Which pixels (H, W) of a view belong to any of some groups."""
    labels = read_labels(question.maps[camera.name])
    field = question.field
    if field is None:
        return lambda ids: np.isin(labels, ids)
    frame = question.rasterizer.render(question.scene.gaussians, camera, channels=field.encodings)
    chances = field.probabilities(frame.image.reshape(-1, field.encodings.shape[1]))
    drawn = frame.alpha >= VOID_BELOW

    def inside(ids: list[int]) -> BoolArray:
        likely = (chances[:, ids] > PROBABLE).any(axis=1).reshape(frame.alpha.shape)
        return likely & drawn

    return inside
