"""Some splats left out at random in each step, against those that only suit single photos.

Where few photos see a place, a splat in front of it can repair the picture of one of them and is in
the way of every other view. Left out now and then, it is no longer needed for that, and those
behind it learn to draw the place themselves (Park 2025, DropGaussian).
"""

from dataclasses import dataclass, replace

import numpy as np

from gaga_core.arrays import BoolArray, DoubleArray
from gaga_core.gaussians import Gaussians
from gaga_core.raster.base import Gradients

_OUT = -20.0  # logit of a splat that is not drawn
HIGHEST = 0.995  # opacity after compensation


@dataclass(frozen=True, eq=False)
class Thinned:
    """Splats with some left out and the opacity of the others raised, and the way back."""

    gaussians: Gaussians
    slopes: DoubleArray | None  # (N,) of the raised logit by the stored one; None = all 1

    def walk_back(self, gradients: Gradients) -> None:
        """Make the gradients by logits those by the logits that are stored, in place."""
        if self.slopes is not None:
            gradients.logit_opacities[:] *= self.slopes[gradients.indices].astype(np.float32)


def thinned(gaussians: Gaussians, share: float, rng: np.random.Generator) -> Thinned:
    """Leave out a ``share`` 0..1 of the splats; the others get opacity o / (1 - ``share``).

    So each covers on average as much as it does when all are drawn. Opacities end at 0.995 and pass
    no gradient there. A share of 0 changes nothing.
    """
    if share == 0:
        return Thinned(gaussians, None)
    is_out: BoolArray = rng.random(len(gaussians)) < share
    opacities = gaussians.opacities.astype(np.float64)
    wanted = opacities / (1 - share)
    raised = np.minimum(wanted, np.maximum(HIGHEST, opacities))
    is_free = wanted == raised
    logits = np.where(is_out, _OUT, _logit(raised))
    slopes = np.where(is_free & ~is_out, (1 - opacities) / np.maximum(1 - raised, 1e-9), 0.0)
    return Thinned(replace(gaussians, logit_opacities=logits.astype(np.float32)), slopes)


def _logit(opacities: DoubleArray) -> DoubleArray:
    inside = np.clip(opacities, 1e-9, 1 - 1e-9)
    result: DoubleArray = np.log(inside / (1 - inside))
    return result
