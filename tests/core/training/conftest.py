"""The scene that trainings of tests learn, made once."""

import pytest

from tests.core.training.train_scenes import Known, known_scene


@pytest.fixture(scope="session")
def known() -> Known:
    return known_scene()
