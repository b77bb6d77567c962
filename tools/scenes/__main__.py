"""``python -m tools.scenes --out DIR --seeds 0..39``: scenes of scanned objects, with truth."""

import tyro

from tools.scenes.make import main

if __name__ == "__main__":
    tyro.cli(main)
