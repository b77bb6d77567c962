"""``python -m tests.web.screenshot PAGE OUT.png``: a picture of a web page in a headless Chromium.

``--select NAME`` clicks the first row of the list with this name; ``--size 390 844 --phone`` is a
phone. The picture of the guide is one of the demo scene.
"""

import argparse
import io
from pathlib import Path
from typing import Any

from PIL import Image
from playwright.sync_api import sync_playwright

from tests.web.conftest import FLAGS, chromium

_PATIENCE_MS = 120_000  # the processor draws
_COLORS = 200  # of the palette


def take(page: Path, size: tuple[int, int], *, phone: bool = False, select: str = "") -> bytes:
    """Open ``page`` and return what the browser shows, a PNG."""
    program = chromium()
    if program is None:
        raise SystemExit("There is no Chromium: install the package chromium.")
    with sync_playwright() as playwright:
        browser = playwright.chromium.launch(executable_path=program, args=FLAGS)
        view: Any = {"width": size[0], "height": size[1]}
        opened = browser.new_page(
            viewport=view, has_touch=phone, is_mobile=phone, color_scheme="dark"
        )
        opened.set_default_timeout(_PATIENCE_MS)
        opened.goto(page.resolve().as_uri())
        opened.wait_for_selector("canvas[data-settled]")
        if select:
            if phone:
                opened.locator("#fold").click()
            opened.locator("#list .name", has_text=select).first.click()
            opened.mouse.move(20, 10)  # over nothing
            opened.wait_for_selector("canvas[data-settled]")
        return opened.screenshot(timeout=_PATIENCE_MS)


def main() -> None:
    """Take the picture that is asked for."""
    parser = argparse.ArgumentParser(description="Take a picture of a web page.")
    parser.add_argument("page", type=Path)
    parser.add_argument("out", type=Path)
    parser.add_argument("--size", type=int, nargs=2, default=(1440, 900))
    parser.add_argument("--phone", action="store_true")
    parser.add_argument("--select", default="")
    chosen = parser.parse_args()
    width, height = chosen.size
    shown = take(chosen.page, (width, height), phone=chosen.phone, select=chosen.select)
    image = Image.open(io.BytesIO(shown)).convert("RGB")
    image.quantize(palette=image.quantize(_COLORS)).save(chosen.out, optimize=True)


if __name__ == "__main__":
    main()
