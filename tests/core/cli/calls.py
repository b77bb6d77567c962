"""Calls of the command ``gaga`` inside this process."""

import json

import pytest

from gaga_core.cli.main import main

Capture = pytest.CaptureFixture[str]


def answer(capsys: Capture, *arguments: str) -> dict[str, object]:
    """What a command prints with --json; fails unless it succeeds."""
    capsys.readouterr()
    assert main([*arguments, "--json"]) == 0
    return json.loads(capsys.readouterr().out)


def refusal(capsys: Capture, *arguments: str, status: int = 1) -> str:
    """The one sentence of a command that fails with exit ``status`` and prints no result."""
    capsys.readouterr()
    assert main(list(arguments)) == status
    captured = capsys.readouterr()
    assert captured.out == ""
    said = captured.err.strip()
    assert said.startswith("gaga: ")
    assert "Traceback" not in said
    return said
