"""Identity encodings (section 3.3): a code per Gaussian, and the linear layer that reads it.

A rendered encoding is F = sum w_i e_i, without background and without normalisation, as the
published code blends it; its label is the argmax of the layer, its probability the softmax.
"""

from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np

from gaga_core.arrays import FloatArray, IntArray, UInt8Array, check_shape
from gaga_core.camera import Camera
from gaga_core.gaussians import Gaussians
from gaga_core.identity.linear_kernels import D, softmax_rows
from gaga_core.io.arrays_file import TEXT, Column, damage, read_columns
from gaga_core.io.files import atomic_write
from gaga_core.raster.base import LabelFrame, Rasterizer
from gaga_core.threads import run_chunks

# --- Identity encodings as colors: similar encodings have similar colors.


_TAILS = (1.0, 99.0)  # percentiles that become 0 and 255: few far encodings do not gray the rest
_SAMPLED = 1 << 17  # rows that axes and percentiles are taken from, evenly spaced


def encoding_colors(encodings: FloatArray) -> UInt8Array:
    """RGB (N, 3) of ``encodings`` (N, D): their three principal components, each over its range.

    Deterministic, signs of the axes included. Encodings that are all alike are gray.
    """
    check_shape("encodings", encodings, ("N", D), np.float32)
    with np.errstate(invalid="ignore"):  # a NaN of any bits; it is left out
        sample = encodings[:: max(1, len(encodings) // _SAMPLED)].astype(np.float64)
    sample = sample[np.isfinite(sample).all(axis=1)]
    if len(sample) == 0:
        return np.full((len(encodings), 3), 128, np.uint8)
    mean = sample.mean(axis=0)
    _, axes = np.linalg.eigh((sample - mean).T @ (sample - mean))  # ascending
    axes = axes[:, :-4:-1]
    signs = np.sign(axes[np.abs(axes).argmax(axis=0), range(axes.shape[1])])
    axes = axes * np.where(signs == 0, 1, signs)
    low, high = np.percentile((sample - mean) @ axes, _TAILS, axis=0)
    span = np.where(high - low > 1e-9, high - low, np.inf)
    projected = (np.nan_to_num(encodings) - mean.astype(np.float32)) @ axes.astype(np.float32)
    shares = np.where(np.isinf(span), 0.5, (projected - low) / np.where(np.isinf(span), 1, span))
    return np.rint(np.clip(shares, 0, 1) * 255).astype(np.uint8)


FILE = "identity.npz"  # in the work folder of a scene
_BLOCK = 1024  # rows whose scores are held at a time by a thread
_CURE = "Lift the groups again."
# Arrays of identity.npz: the layer, and what it says of each Gaussian.
_LAYER = {
    "encodings": Column(np.float32, ("N", D)),
    "weight": Column(np.float32, ("classes", D)),
    "bias": Column(np.float32, ("classes",)),
    "labels": Column(np.int32, ("N",), low=0, below="classes"),
}
LABELLING = {
    "confidence": Column(np.float32, ("N",)),
    "colors": Column(np.uint8, ("N", 3), optional=True),
    "mode": TEXT,
    "bank": replace(TEXT, optional=True),
}


@dataclass(frozen=True, eq=False)
class IdentityField:
    """Encodings of N Gaussians and the layer over the classes 0 (none) to G."""

    encodings: FloatArray  # (N, D)
    weight: FloatArray  # (G + 1, D)
    bias: FloatArray  # (G + 1,)

    def __post_init__(self) -> None:
        check_shape("encodings", self.encodings, ("N", D), np.float32)
        check_shape("weight", self.weight, ("G + 1", D), np.float32)
        check_shape("bias", self.bias, (len(self.weight),), np.float32)
        if len(self.weight) == 0:
            raise ValueError("weight: needs a row for class 0")

    @property
    def n_groups(self) -> int:
        """G: classes without "none"."""
        return len(self.weight) - 1

    def labels(self) -> IntArray:
        """Label (N,) of each Gaussian: argmax of the layer on its own encoding."""
        return self.classify(self.encodings)[0]

    def probabilities(self, features: FloatArray) -> FloatArray:
        """Softmax over the classes (P, G + 1) of ``features`` (P, D)."""
        check_shape("features", features, ("P", D), np.float32)
        out = np.empty((len(features), len(self.weight)), np.float32)
        softmax_rows(_copied(features), _copied(self.weight.T), _copied(self.bias), out)
        return out

    def classify(self, features: FloatArray) -> tuple[IntArray, FloatArray]:
        """Labels (P,) and their probabilities (P,) of ``features`` (P, D), block by block."""
        check_shape("features", features, ("P", D), np.float32)
        labels = np.zeros(len(features), np.int32)
        confidence = np.zeros(len(features), np.float32)

        def work(start: int, stop: int) -> None:
            p = self.probabilities(features[start:stop])
            labels[start:stop] = p.argmax(axis=1)
            confidence[start:stop] = p.max(axis=1)

        run_chunks(work, len(features), _BLOCK)
        return labels, confidence


@dataclass(frozen=True, eq=False)
class Identity:
    """The identities of a scene: the field, and for each Gaussian a label to select it by."""

    field: IdentityField
    labels: IntArray  # (N,) 1..G, 0 = none; what the field decodes
    confidence: FloatArray  # (N,) 0..1
    mode: str  # vote, refine or paper
    bank: str = ""  # `grouping.bank_file.bank_digest` of the groups; "" = older, not known

    def __post_init__(self) -> None:
        n = len(self.field.encodings)
        check_shape("labels", self.labels, (n,), np.int32)
        check_shape("confidence", self.confidence, (n,), np.float32)


@dataclass(frozen=True)
class LiftFigures:
    """Figures of a mode; None where it has no such figure."""

    from_bank: int | None = None  # Gaussians labelled by the memory bank alone
    from_neighbours: int | None = None  # Gaussians that no view shows, labelled by neighbours
    max_cosine: float | None = None  # of the two closest codes
    sweeps: int | None = None  # of the fit to the vote; 0 = the vote was not improved
    rows: int | None = None  # sampled pixels fitted to or trained on
    steps: int | None = None
    best_step: int | None = None  # refine: 0 = the vote was not improved
    resumed_at: int | None = None  # paper: step that the run went on from
    accuracy_before: float | None = None  # right pixels, held out
    accuracy: float | None = None  # vote, refine: held out; paper: of the last views trained on
    loss_before: float | None = None  # refine: nats, held out; paper: over ln(classes)
    loss: float | None = None


def _copied(array: FloatArray) -> FloatArray:
    """A copy as kernels take it, however the original lies in memory."""
    return np.array(array, np.float32, order="C")


def decode_view(
    field: IdentityField,
    gaussians: Gaussians,
    camera: Camera,
    rasterizer: Rasterizer,
    *,
    void_below: float,
) -> LabelFrame:
    """Labels of a view as the paper reads them: splat the encodings, classify every pixel.

    Pixels covered by less than ``void_below`` are 0. The confidence is the probability of the
    label. `Rasterizer.label_splat` gives nearly the same picture, exactly and without encodings.
    """
    check_shape("encodings", field.encodings, (len(gaussians), D))
    frame = rasterizer.render(gaussians, camera, channels=field.encodings)
    labels, confidence = field.classify(frame.image.reshape(-1, D))
    void = frame.alpha < void_below
    shape = frame.alpha.shape
    return LabelFrame(
        np.where(void, np.int32(0), labels.reshape(shape)),
        np.where(void, np.float32(0), confidence.reshape(shape)),
    )


def save_identity(path: Path, identity: Identity) -> None:
    """Write ``identity.npz``: encodings, weight, bias, labels, confidence, colors, mode, bank."""
    with atomic_write(path) as temporary, temporary.open("wb") as file:
        np.savez(
            file,
            encodings=identity.field.encodings,
            weight=identity.field.weight,
            bias=identity.field.bias,
            labels=identity.labels,
            confidence=identity.confidence,
            colors=encoding_colors(identity.field.encodings),
            mode=np.array(identity.mode),
            bank=np.array(identity.bank),
        )


def load_identity(path: Path) -> Identity:
    """Read ``identity.npz``; ``GagaError`` when it is missing or damaged."""
    arrays = read_columns(path, _CURE, _LAYER | LABELLING)
    with damage(path, _CURE):
        field = IdentityField(arrays["encodings"], arrays["weight"], arrays["bias"])
        texts = str(arrays["mode"]), str(arrays.get("bank", ""))
        return Identity(field, arrays["labels"], arrays["confidence"], *texts)
