"""A display of our own: Xvfb, ended with the block."""

import os
import subprocess
from collections.abc import Iterator
from contextlib import contextmanager

from Xlib import X, display


@contextmanager
def xvfb(size: tuple[int, int] = (1920, 1080)) -> Iterator[str]:
    """Start Xvfb of ``size`` pixels on a free display number and point DISPLAY at it.

    ``OSError`` without Xvfb.
    """
    read_end, write_end = os.pipe()
    server = subprocess.Popen(
        [
            "Xvfb",
            "-displayfd",
            str(write_end),
            "-screen",
            "0",
            f"{size[0]}x{size[1]}x24",
            "-noreset",
            "-nolisten",
            "tcp",
        ],
        pass_fds=(write_end,),
        stderr=subprocess.DEVNULL,
    )
    os.close(write_end)
    with os.fdopen(read_end) as pipe:
        name = f":{pipe.readline().strip()}"
    before = os.environ.get("DISPLAY")
    os.environ["DISPLAY"] = name
    try:
        yield name
    finally:
        server.terminate()
        server.wait(timeout=10)
        if before is None:
            del os.environ["DISPLAY"]
        else:
            os.environ["DISPLAY"] = before


@contextmanager
def openbox() -> Iterator[None]:
    """A window manager on DISPLAY, from when it manages until the block ends."""
    watched = display.Display()
    root, names = watched.screen().root, watched.intern_atom("_NET_SUPPORTED")
    root.change_attributes(event_mask=X.PropertyChangeMask)
    watched.sync()
    manager = subprocess.Popen(["openbox"], stdout=subprocess.DEVNULL, stderr=subprocess.DEVNULL)
    try:
        while root.get_full_property(names, X.AnyPropertyType) is None:
            watched.next_event()
        watched.close()
        yield
    finally:
        manager.terminate()
        manager.wait(timeout=10)
