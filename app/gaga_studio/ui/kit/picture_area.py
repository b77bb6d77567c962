"""The area of the picture on the screen, for everything drawn over it."""

from dataclasses import dataclass

Rect = tuple[float, float, float, float]  # left, top, right, bottom


def overlap(one: Rect, two: Rect) -> bool:
    """Whether two rectangles have a part in common."""
    return one[0] < two[2] and two[0] < one[2] and one[1] < two[3] and two[1] < one[3]


@dataclass
class PictureArea:
    """A rectangle in pixels of the screen, and what covers its edges."""

    left: float = 0.0
    top: float = 0.0
    width: float = 400.0
    height: float = 300.0
    offer_top: float = float("inf")  # y of the upper edge of the offer of the next stage
    has_inspector: bool = True  # that panel is seen, too
    has_options: bool = False  # of the tool, for which the tool bar has no room
    options: Rect | None = None  # where those of the tool lie over the picture, pixels
    head_bottom: float = 0.0  # y below what lies in the upper left corner
    chip_bottom: float = 0.0  # lower edge of the choices and of the button at its head
    card_bottom: float = 0.0  # lower edge of the card of a mask at its head; 0: it is not there
    live_right: float = 0.0  # right edge of the card of a training; 0: there is none
    live_bottom: float = 0.0  # lower edge of the card of a training; 0: there is none
    cube_height: float = 0.0  # of the view cube in the upper right corner
    steps_height: float = 0.0  # of the first steps at the foot of an empty picture
    notices: tuple[Rect, ...] = ()  # that were drawn last
    labels: tuple[Rect, ...] = ()  # of measured lengths, that were drawn last

    @property
    def bottom(self) -> float:
        """The y of the lower edge."""
        return self.top + self.height

    def has_words_in(self, rect: Rect) -> bool:
        """Whether a notice or a label lies over a part of ``rect``."""
        return any(overlap(rect, other) for other in (*self.notices, *self.labels))

    @property
    def size(self) -> tuple[int, int]:
        """Width and height in whole pixels, at least 1."""
        return max(round(self.width), 1), max(round(self.height), 1)
