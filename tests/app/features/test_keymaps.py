"""Profiles of shortcuts: every key means one thing, and every command stays reachable."""

from collections.abc import Callable
from dataclasses import replace

import pytest

from gaga_studio.features.blender_keys import BLENDER
from gaga_studio.features.commands import (
    COMMANDS,
    PROFILES,
    command,
    for_shortcut,
    keys_of,
    shortcut_of,
)
from gaga_studio.session.session import Session
from gaga_studio.ui.dialogs.preferences import all_keys


@pytest.mark.parametrize("profile", PROFILES)
def test_no_key_means_two_things(profile: str) -> None:
    taken: dict[str, str] = {}
    for id_, listed in PROFILES[profile].items():
        for keys in listed:
            assert keys not in taken, (keys, id_, taken[keys])
            taken[keys] = id_


def test_profiles_name_commands_that_exist_and_keys_that_the_window_knows() -> None:
    ids = {c.id for c in COMMANDS}
    assert set(BLENDER) <= ids
    assert all(set(table) == ids for table in PROFILES.values())
    assert {"G", "X", ".", "[", "Home"} <= set(all_keys())


def test_the_same_key_follows_the_profile(new_session: Callable[[], Session]) -> None:
    session = new_session()
    chosen = for_shortcut("R", session)
    assert chosen is not None
    assert chosen.id == "tool.rect"
    session.settings = replace(session.settings, keys="blender")
    chosen = for_shortcut("R", session)
    assert chosen is not None
    assert chosen.id == "tool.rotate"
    assert shortcut_of(command("edit.delete"), session) == "X"
    assert keys_of(command("tool.polygon"), session) == ()
    session.rig.is_flying = True
    assert for_shortcut("S", session) is None  # flies back
    session.rig.is_flying = False
    session.settings = replace(session.settings, keys="unknown")
    assert shortcut_of(command("tool.rect"), session) == "R"
