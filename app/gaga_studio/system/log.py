"""The log file: what went wrong, in full, for the person who fixes it."""

import logging
from logging.handlers import RotatingFileHandler
from pathlib import Path

from gaga_studio.system import paths

_MOST_BYTES = 1 << 20


def log_file() -> Path:
    """Where the log is."""
    return paths.home() / "log.txt"


def start_log() -> Path | None:
    """Write warnings and errors to the log file from now on; None when it cannot be written."""
    path = log_file()
    try:
        path.parent.mkdir(parents=True, exist_ok=True)
        handler = RotatingFileHandler(path, maxBytes=_MOST_BYTES, backupCount=1, encoding="utf-8")
    except OSError:
        return None
    handler.setFormatter(logging.Formatter("%(asctime)s %(levelname)s %(name)s: %(message)s"))
    handler.setLevel(logging.WARNING)
    logging.getLogger().addHandler(handler)
    return path
