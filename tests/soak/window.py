"""``python -m tests.soak.window MINUTES [SEED]``: random events in the real window, slow frames.

A window that was closed by an event is opened again. Status 1 when something was logged as an
error, or when memory grows by more than a tenth after the first third.
"""

import faulthandler
import logging
import os
import random
import shutil
import sys
import tempfile
import time
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass, field
from pathlib import Path

import psutil
from imgui_bundle import hello_imgui, immapp

from gaga_studio.features.commands import new_session
from gaga_studio.features.find import association
from gaga_studio.session.settings import Settings
from gaga_studio.studio import Studio
from gaga_studio.system.window import WindowOptions
from tests.app.folders import write_scene
from tests.display import xvfb
from tests.soak.hand import Hand, Sent

_SIZE = (1000, 640)
_WINDOW_S = 90.0  # a window is closed and opened again after so long
_MOST_GROWTH = 0.1


@dataclass
class Soak:
    """What happened."""

    sent: Sent = field(default_factory=Sent)
    n_windows: int = 0
    n_frames: int = 0
    memory: list[int] = field(default_factory=list)  # bytes, at the end of each window
    logged: list[str] = field(default_factory=list)  # errors


def soak(minutes: float, seed: int, folder: Path) -> Soak:
    """Use windows at random for so long, in ``folder``."""
    result, end, n = Soak(), time.monotonic() + 60 * minutes, 0
    _made_scene(folder / "made")
    with _errors(result.logged):
        while time.monotonic() < end:
            n += 1
            shutil.rmtree(folder / "scene", ignore_errors=True)
            shutil.copytree(folder / "made", folder / "scene")
            _one_window(result, folder / "scene", seed * 1000 + n, min(end, _later()))
    return result


def _later() -> float:
    return time.monotonic() + _WINDOW_S


def _made_scene(folder: Path) -> None:
    write_scene(folder)
    session = new_session(Settings(preset="paper", identities="none"))
    session.open(folder)
    assert session.jobs.wait(600)
    association.associate(session)
    assert session.jobs.wait(600)
    session.save()
    assert session.jobs.wait(600)
    session.shut_down()


def _one_window(result: Soak, scene: Path, seed: int, end: float) -> None:
    """Open a window, use it until it closes or ``end``."""
    session = new_session(Settings(first_steps_done=True, preset="paper", identities="none"))
    studio = Studio(scene, session=session, options=WindowOptions(size=_SIZE))
    studio.ui.files.use_native = False
    studio.never_idle = True
    params = studio.window.params()
    params.fps_idling.enable_idling = False
    rng = random.Random(seed)
    hands: list[Hand] = []

    def after_frame() -> None:
        result.n_frames += 1
        if not hands and studio.is_settled:
            hands.append(Hand(_SIZE, seed, result.sent))
            hands[0].start()
        time.sleep(rng.choice((0.0, 0.0, 0.0, 0.0, 0.0, 0.02, 0.1)))
        if rng.random() < 0.003:
            time.sleep(rng.uniform(0.3, 1.5))
        faulthandler.dump_traceback_later(120, exit=True)  # a hang is a finding
        if time.monotonic() > end:
            hello_imgui.get_runner_params().app_shall_exit = True

    close = params.callbacks.before_exit

    def before_exit() -> None:
        for hand in hands:  # nothing may be sent to a window that is gone
            hand.is_over = True
            hand.join()
        if close is not None:
            close()

    params.callbacks.after_swap, params.callbacks.before_exit = after_frame, before_exit
    immapp.run(params, immapp.AddOnsParams())
    faulthandler.cancel_dump_traceback_later()
    result.n_windows += 1
    result.memory.append(psutil.Process().memory_info().rss)


@contextmanager
def _errors(found: list[str]) -> Iterator[None]:
    """Collect what is logged as an error, with tracebacks."""
    handler = logging.Handler(logging.ERROR)
    handler.emit = lambda record: found.append(handler.format(record))  # type: ignore[method-assign]
    logging.getLogger().addHandler(handler)
    try:
        yield
    finally:
        logging.getLogger().removeHandler(handler)


def main(minutes: float, seed: int) -> int:
    """Soak in a folder and a home of its own; print the figures."""
    with tempfile.TemporaryDirectory(ignore_cleanup_errors=True) as name, xvfb():
        folder = Path(name)
        for variable in ("HOME", "GAGA_HOME"):
            os.environ[variable] = str(folder / "home")
        (folder / "home").mkdir()
        os.chdir(folder)
        result = soak(minutes, seed, folder)
    for text in dict.fromkeys(result.logged):
        sys.stdout.write(f"{text}\n")
    later = result.memory[len(result.memory) // 3 :]
    growth = max(later) / later[0] - 1
    sys.stdout.write(
        f"seed {seed}: {result.n_windows} windows, {result.n_frames:,} frames, "
        f"{result.sent.n_events:,} events, {len(result.logged)} errors, "
        f"{[m >> 20 for m in result.memory]} MB\n"
    )
    return 1 if result.logged or growth > _MOST_GROWTH else 0


if __name__ == "__main__":
    sys.exit(main(float(sys.argv[1]), int(sys.argv[2]) if len(sys.argv) > 2 else 1))
