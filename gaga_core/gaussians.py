"""3D Gaussians as numpy columns."""

import re
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from types import MappingProxyType

import numpy as np

from gaga_core.arrays import (
    AnyArray,
    BoolArray,
    DoubleArray,
    FloatArray,
    IntArray,
    LongArray,
    check_shape,
)

# What Brush, SuperSplat and others write into the header of a PLY file.
_MIP_HINTS = ("splatrendermode: mip", "antialiased 1", "antialiased: 1")
_MIP_COMMENT = "SplatRenderMode: mip"  # the hint that is written here
_METRE_COMMENT = "1 unit = 1 metre"  # of files whose scale is known
_UP = re.compile(r"up (\S+) (\S+) (\S+)")  # the comment of files that say which way is up


@dataclass(frozen=True, eq=False)
class Gaussians:
    """A set of 3D Gaussians with raw parameters, as 3DGS files store them (Kerbl 2023).

    All standard columns are C-contiguous float32. ``extra`` holds every other column of the file
    by name, in file order and in its own dtype: normals, ``obj_dc_*``, anything unknown. They
    survive a round trip. ``comments`` are the file's header comments: render mode, up, unit.

    Raises ``ValueError`` when columns disagree in length or shape.
    """

    means: FloatArray  # (N, 3) world
    quats: FloatArray  # (N, 4) wxyz, any length
    log_scales: FloatArray  # (N, 3) natural log of the standard deviation
    logit_opacities: FloatArray  # (N,)
    sh: FloatArray  # (N, S, 3), S = (degree + 1)^2
    extra: Mapping[str, AnyArray] = field(default_factory=lambda: MappingProxyType({}))  # each (N,)
    comments: tuple[str, ...] = ()

    def __post_init__(self) -> None:
        n = len(self.means)
        check_shape("means", self.means, (n, 3), np.float32)
        check_shape("quats", self.quats, (n, 4), np.float32)
        check_shape("log_scales", self.log_scales, (n, 3), np.float32)
        check_shape("logit_opacities", self.logit_opacities, (n,), np.float32)
        check_shape("sh", self.sh, (n, "S", 3), np.float32)
        if self.sh.shape[1] not in (1, 4, 9, 16, 25):
            raise ValueError(f"sh: {self.sh.shape[1]} coefficients is no full degree")
        for name, column in self.extra.items():
            check_shape(f"extra[{name}]", column, (n,))

    def __len__(self) -> int:
        return len(self.means)

    @property
    def sh_degree(self) -> int:
        """Degree of the view-dependent color: 0 to 4."""
        return {1: 0, 4: 1, 9: 2, 16: 3, 25: 4}[self.sh.shape[1]]

    @property
    def is_antialiased(self) -> bool:
        """Whether the comments ask for the antialiased (mip) mode: see `raster.base`."""
        return any(hint in comment.lower() for comment in self.comments for hint in _MIP_HINTS)

    def with_antialiasing(self, antialiased: bool) -> "Gaussians":
        """The same splats, whose comments ask for the antialiased mode, or do not."""
        if antialiased == self.is_antialiased:
            return self
        others = (c for c in self.comments if not any(h in c.lower() for h in _MIP_HINTS))
        return replace(self, comments=(*others, *([_MIP_COMMENT] if antialiased else [])))

    @property
    def up(self) -> DoubleArray | None:
        """Which way is up (3,), unit, as the comments say; None where they do not."""
        for words in filter(None, map(_UP.fullmatch, self.comments)):
            try:
                up = np.array(words.groups(), np.float64)
            except ValueError:  # a sentence of someone else
                continue
            length = float(np.linalg.norm(up))
            if 0 < length < np.inf:
                return up / length
        return None

    def with_up(self, up: AnyArray | Sequence[float]) -> "Gaussians":
        """The same splats, whose comments say that ``up`` (3,) is up."""
        others = (c for c in self.comments if not _UP.fullmatch(c))
        x, y, z = (float(value) + 0.0 for value in up)
        return replace(self, comments=(*others, f"up {x:.9g} {y:.9g} {z:.9g}"))

    @property
    def is_metric(self) -> bool:
        """Whether the comments say that a unit is a metre."""
        return _METRE_COMMENT in self.comments

    def with_metres(self, is_metric: bool = True) -> "Gaussians":
        """The same splats, whose comments say that a unit is a metre, or do not."""
        if is_metric == self.is_metric:
            return self
        others = (c for c in self.comments if c != _METRE_COMMENT)
        return replace(self, comments=(*others, *([_METRE_COMMENT] if is_metric else [])))

    @property
    def scales(self) -> FloatArray:
        """Standard deviations (N, 3), scene units."""
        return np.exp(self.log_scales)

    @property
    def opacities(self) -> FloatArray:
        """Opacities (N,) in 0..1."""
        with np.errstate(over="ignore"):
            result: FloatArray = np.float32(1) / (np.float32(1) + np.exp(-self.logit_opacities))
        return result

    def bare(self, indices: IntArray | LongArray | BoolArray | slice) -> "Gaussians":
        """The chosen rows, in the order given, without extra columns and comments."""
        return Gaussians(
            self.means[indices],
            self.quats[indices],
            self.log_scales[indices],
            self.logit_opacities[indices],
            self.sh[indices],
        )

    def take(self, indices: IntArray | LongArray | BoolArray) -> "Gaussians":
        """The chosen rows, in the order given, with all extra columns."""
        return Gaussians(
            means=self.means[indices],
            quats=self.quats[indices],
            log_scales=self.log_scales[indices],
            logit_opacities=self.logit_opacities[indices],
            sh=self.sh[indices],
            extra=MappingProxyType({k: v[indices] for k, v in self.extra.items()}),
            comments=self.comments,
        )
