"""Settings of `gaga_core.scene.fill`."""

from dataclasses import dataclass


@dataclass(frozen=True)
class FillConfig:
    """How a hole is found and filled."""

    lighten: bool = True  # take the object's shadow off the surface that it stood on
    most_views: int = 64  # photos that are looked at, spread over those that show the object
    view_pixels: int = 320  # longer side of a looked-at view
    seen: float = 0.1  # pixels: a splat with less weight in all views together was never seen
    seen_share: float = 0.15  # of its weight without the object: less shimmers through it only
    most_surfaces: int = 4  # that are filled
    most_cells: int = 200  # of a side of a chart
    reach: float = 0.6  # of the object's size: how far around it a surface is looked at
    seed: int = 0  # of the choice of donors
    model: str = ""  # file of an inpainting model that colors the hole; "" = continue its rim
    model_sha256: str = ""  # of that file, hexadecimal; "" = any

    def __post_init__(self) -> None:
        if self.most_views < 1 or self.view_pixels < 16 or self.most_cells < 16:
            raise ValueError("most_views, view_pixels, most_cells: too small")
        if self.model_sha256 and not self.model:
            raise ValueError("model_sha256: there is no model that it could be of")
        if self.reach <= 0 or self.seen < 0 or self.most_surfaces < 1:
            raise ValueError("reach, seen, most_surfaces: too small")
