"""Programs that tests start: each is forked from one process that has imported what they need."""

import multiprocessing
from multiprocessing.context import ForkServerContext

import pytest


@pytest.fixture(scope="session")
def programs() -> ForkServerContext:
    """Starts processes in which the core and torch are imported already."""
    context = multiprocessing.get_context("forkserver")
    context.set_forkserver_preload(["pytest", "torch", "tests.core.scene.two_writers"])
    return context
