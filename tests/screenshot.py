"""``python -m tests.screenshot OUT.png``: the README's picture, taken of the real window.

The demo scene is made, its masks are associated, one object is selected; then the whole window is
captured. Needs Xvfb, no display.
"""

import argparse
import os
import tempfile
from pathlib import Path

from gaga_studio.actions import files, objects
from tests.app.window.driver import Driver, drive
from tests.display import xvfb


def main() -> None:
    """Take the picture."""
    parser = argparse.ArgumentParser(description="Take a screenshot of the window.")
    parser.add_argument("out", type=Path)
    parser.add_argument("--size", type=int, nargs=2, default=(1440, 900))
    parser.add_argument("--home", type=Path, help="keeps the demo scene between runs")
    chosen = parser.parse_args()
    with tempfile.TemporaryDirectory() as folder, xvfb():
        os.environ["GAGA_HOME"] = str(chosen.home or folder)

        def walk(driver: Driver) -> None:
            _show_an_object(driver)
            driver.capture(chosen.out)

        drive(walk, demo=True, size=tuple(chosen.size))


def _show_an_object(driver: Driver) -> None:
    """Associate (unless a saved project brought groups) and select the object at the middle."""
    if not (driver.session.need().scene.labels > 0).any():
        files.associate(driver.session)
        driver.settle()
    width, height = driver.size
    driver.click_picture(width * 0.44, height * 0.57)
    objects.rename(driver.session, driver.session.selected_groups()[0], "teapot")
    driver.move_to(width * 0.75, -20)  # on an empty part of the tool bar: nothing is hovered
    # Notices are read once and fade; the picture shows the window at rest.
    driver.session.notices = ()
    driver.settle()


if __name__ == "__main__":
    main()
