"""Two pictures in one, with a line between them."""

from dataclasses import dataclass
from typing import Literal, get_args

import numpy as np

from gaga_core.arrays import UInt8Array
from gaga_core.errors import GagaError

What = Literal["rgb", "groups", "depth"]
_LINE = 400  # widths of the line that a picture is wide


@dataclass(frozen=True)
class Split:
    """What lies left of the line in a film, and where the line is."""

    left: What = "rgb"
    at: float = 0.5  # share of the width that is left of the line
    sweeps: bool = False  # the line goes once from the left edge to the right one, and back

    def __post_init__(self) -> None:
        if self.left not in get_args(What):
            kinds = ", ".join(get_args(What))
            raise GagaError(f"There is nothing called {self.left!r} to film. Choose of {kinds}.")
        if not 0 <= self.at <= 1:
            raise GagaError(f"The line of a split film must be between 0 and 1, not {self.at}.")

    def share(self, t: float) -> float:
        """The share of the width left of the line at a time 0..1 of the film."""
        return 0.5 - 0.5 * float(np.cos(2 * np.pi * t)) if self.sweeps else self.at


def joined(left: UInt8Array, right: UInt8Array, share: float) -> UInt8Array:
    """The left picture up to ``share`` of the width, the right one from there on, (H, W, 3).

    Between them is a white line; there is none at the edges, where one picture is whole.
    """
    if left.shape != right.shape:
        raise ValueError(f"left: expected {right.shape}, got {left.shape}")
    width = right.shape[1]
    at = round(min(max(share, 0.0), 1.0) * width)
    picture = np.concatenate([left[:, :at], right[:, at:]], axis=1)
    if 0 < at < width:
        half = max(width // _LINE, 2) // 2
        picture[:, max(at - half, 0) : at + half] = 255
    return picture
