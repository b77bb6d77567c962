"""What the window says of a folder with too few photos for splats."""

from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest

from gaga_core.io.images import write_rgb
from gaga_studio.features import reconstruction
from gaga_studio.session.session import Session


@pytest.mark.parametrize("n", [1, 2, 3])
def test_too_few_photos_say_what_is_missing(
    new_session: Callable[[], Session], tmp_path: Path, n: int
) -> None:
    folder = tmp_path / "photos"
    folder.mkdir()
    for i in range(n):
        write_rgb(folder / f"{i}.png", np.full((32, 48, 3), 0.2 * i, np.float32))
    session = new_session()
    session.open(folder)
    assert session.jobs.wait()
    assert session.photos is not None
    plural = "" if n == 1 else "s"
    assert reconstruction.title(session) == f"Make splats from {n} photo{plural}"
    assert ("it takes at least 3" in reconstruction.why_not(session)) == (n < 3)
