"""The demo scene: a breakfast table in a sunlit room, made by our own code from a seed.

Every surface is a parametric patch; discs are laid on it in staggered rows; light is baked into
them; photos and masks are then made from the splats, so that poses, truth and model agree.
"""

from gaga_core.demo.config import DemoConfig
from gaga_core.demo.folder import ensure_demo, make_demo_stage

__all__ = ["DemoConfig", "ensure_demo", "make_demo_stage"]
