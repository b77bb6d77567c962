"""From text prompts to masks: the groups that a phrase means, cut out of the views' group maps."""

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from PIL import Image

from gaga_core.camera import Camera
from gaga_core.io.datasets.base import PromptTruth
from gaga_core.io.masks import read_labels
from gaga_core.io.staging import publish_all, staging_folder
from gaga_core.pipeline.search import Pictures, find_in_view, index_scene, search
from gaga_core.progress import Progress, Stage
from gaga_core.raster.base import Rasterizer
from gaga_core.scene.scene import Scene

STAGE = "Find prompts"


@dataclass(frozen=True, eq=False)
class Question:
    """What a method that answers text prompts may use."""

    scene: Scene  # the splats with their groups
    train: tuple[Camera, ...]
    views: tuple[Camera, ...]  # the views to answer for; the published protocol uses the first
    maps: Mapping[str, Path]  # group maps of those views, by view name
    rasterizer: Rasterizer


Answers = Mapping[str, Sequence[int]]  # phrase -> group ids; without an entry: not answered
Find = Callable[[Question, Sequence[str]], Stage[Answers]]


@dataclass(frozen=True)
class FindConfig:
    """Who answers: a detector in the first view, else an index of pictures, else words alone."""

    detector: Path | None = None  # folder of a Grounding DINO or OWLv2 model
    embedder: Path | None = None  # folder of a CLIP or SigLIP model

    def find(self) -> Find:
        """The way of answering."""
        if self.detector is not None:
            return by_detector(self.detector)
        return by_words(self.embedder)


def by_detector(folder: Path) -> Find:
    """Boxes in the rendered first view -> groups by area (section 6 of the paper)."""

    def find(question: Question, phrases: Sequence[str]) -> Stage[Answers]:
        from gaga_core.query.detector import load_detector

        detector, view, answers = load_detector(folder), question.views[:1], {}
        for i, phrase in enumerate(phrases):
            yield Progress(STAGE, i, len(phrases), phrase)
            stage = find_in_view(
                question.scene, view, phrase, detector, rasterizer=question.rasterizer
            )
            answer = yield from stage
            answers[phrase] = answer.groups[: answer.n_meant].tolist()
        return answers

    return find


def by_words(embedder: Path | None = None) -> Find:
    """What the search box finds: colors, sizes and places, and nouns through an index if given."""

    def find(question: Question, phrases: Sequence[str]) -> Stage[Answers]:
        pictures = None
        if embedder is not None:
            pictures = yield from _index(question, embedder)
        answers = {}
        for i, phrase in enumerate(phrases):
            yield Progress(STAGE, i, len(phrases), phrase)
            answer = search(
                question.scene,
                phrase,
                cameras=question.train,
                camera=question.views[0],
                pictures=pictures,
            )
            # With an index the best group is an answer, however unsure; words alone may fail.
            n = answer.n_meant if pictures is None else max(1, answer.n_meant)
            answers[phrase] = answer.groups[:n].tolist()
        return answers

    return find


def _index(question: Question, folder: Path) -> Stage[Pictures]:
    from gaga_core.query.embed import load_embedder
    from gaga_core.query.index import TextVectors

    embedder = load_embedder(folder)
    index = yield from index_scene(
        question.scene, question.train, embedder, rasterizer=question.rasterizer
    )
    return Pictures(index, TextVectors(index.model, lambda: embedder))


def answer_prompts(question: Question, prompts: PromptTruth, out: Path, find: Find) -> Stage[Path]:
    """Masks ``out/prompts/<key>/<text prompt>.png`` (0 or 255) of every prompt in every view.

    A prompt that ``find`` has no answer to gets no file, so that it is scored as missing.
    """
    answers = yield from find(question, prompts.prompts)
    with staging_folder(out) as staging:
        (staging / "prompts").mkdir()
        for i, (key, name) in enumerate(prompts.views.items()):
            yield Progress(STAGE, i, len(prompts.views), name)
            if name not in question.maps:
                continue
            groups = read_labels(question.maps[name])
            (staging / "prompts" / key).mkdir()
            for phrase in prompts.prompts:
                ids = list(answers.get(phrase, ()))
                if ids:
                    mask = np.isin(groups, ids).astype(np.uint8) * np.uint8(255)
                    Image.fromarray(mask).save(staging / "prompts" / key / f"{phrase}.png")
        publish_all(staging, ["prompts"], out)
    return out / "prompts"
