"""The menu of bookmarks in a window."""

from dataclasses import replace
from pathlib import Path

import pytest

from gaga_studio.features import camera
from tests.app.window.driver import Driver, drive

pytestmark = pytest.mark.window


def test_the_menu_goes_to_each_bookmark_also_of_one_name(display: str, grouped_copy: Path) -> None:
    def test(d: Driver) -> None:
        d.menu("Camera/Bookmark this view")
        assert camera.bookmarks(d.session)[0].name in d.session.hint
        start = d.session.rig.pose
        d.on_main(lambda: camera.add_bookmark(d.session, camera.bookmarks(d.session)[0].name))
        d.session.rig.pose = replace(start, yaw=start.yaw + 1)
        d.menu("Camera/###Go to bookmark/###View 1")
        d.settle()
        assert d.session.rig.pose.yaw == pytest.approx(start.yaw)
        d.session.rig.pose = replace(start, yaw=start.yaw + 1)
        d.menu("Camera/###Go to bookmark/###View 1camera.recall 1")
        d.settle()
        assert d.session.rig.pose.yaw == pytest.approx(start.yaw)

    drive(test, path=grouped_copy)
