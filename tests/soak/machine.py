"""The session as a state machine: commands, undo, save, reopen, autosave and crashes in any order.

After each step the scene is compared, bit for bit, with what it was when the history was in the
same state before. What comes back after a crash is compared with what the autosave was made of.
Autosaves and projects are damaged, too: they are refused in a sentence, or the walk goes on with
what they hold.
"""

import hashlib
import json
import os
import random
import re
import shutil
import subprocess
import sys
import tempfile
import time
from collections import Counter
from dataclasses import dataclass, replace
from functools import cache
from pathlib import Path
from types import MappingProxyType
from typing import ClassVar

import numpy as np
from hypothesis import strategies as st
from hypothesis.stateful import RuleBasedStateMachine, initialize, invariant, rule

from gaga_core.errors import LONGEST_SENTENCE
from gaga_core.grouping.memory_bank import Decision, MemoryBank
from gaga_core.io.folder.lock import LOCK, OWNER
from gaga_core.io.splats.splat_files import write_splats
from gaga_core.scene import edits
from gaga_core.scene.project import saved_scene, scene_arrays
from gaga_core.scene.scene import Scene
from gaga_studio.features import autosave, commands, files, folders, objects, selection, transform
from gaga_studio.features.commands import new_session
from gaga_studio.session.session import Session
from gaga_studio.session.settings import Settings
from tests.fuzz.formats import changed
from tests.fuzz.mutate import mutated
from tests.scenes import objects_scene, random_gaussians

COMMANDS = (
    "edit.undo", "edit.redo", "edit.duplicate", "edit.delete", "edit.mirror_x", "edit.cancel",
    "edit.delete_floaters", "edit.restore", "select.all", "select.none", "select.invert",
    "select.grow", "select.shrink", "select.whole", "select.keep", "object.hide", "object.isolate",
    "object.show_all", "object.merge", "object.separate", "object.split", "object.lock",
    "object.unlock_all", "object.folder", "object.folder_out", "object.leave_parent",
    "select.children", "camera.add_bookmark", "camera.add_keyframe", "camera.clear_path",
)  # fmt: skip
MOST_SPLATS = 4000  # duplicates of everything would double the scene for ever
_NEVER_S = 1e6
_WRONG = re.compile("went wrong|see the log")  # of the program's, not of the person's
Snapshot = dict[str, str]  # digest of each column and table


def snapshot(scene: Scene) -> Snapshot:
    """Digests of everything that edits change."""
    g = scene.gaussians
    columns = {"means": g.means, "quats": g.quats, "scales": g.log_scales, "sh": g.sh}
    columns |= {"opacities": g.logit_opacities, **scene_arrays(scene)}
    digests = {
        name: hashlib.sha256(f"{a.dtype}{a.shape}".encode() + a.tobytes()).hexdigest()
        for name, a in columns.items()
    }
    tables = {"names": scene.names, "colors": scene.colors, "sets": list(scene.named_selections)}
    tables |= {"folders": scene.folders, "weights": scene.weights}
    return digests | {name: repr(table) for name, table in tables.items()}


@dataclass(frozen=True)
class _Kept:
    """What an autosave was made of."""

    states: tuple[Snapshot, ...]  # before the oldest entry, and after each
    cursor: int
    titles: tuple[str, ...]


@cache
def _ended_process() -> int:
    """The number of a process that has ended."""
    ended = subprocess.Popen([sys.executable, "-c", ""])
    ended.wait()
    return ended.pid


@cache
def _good_files() -> dict[str, bytes]:
    """Two files of splats by name, made once in a process."""
    made = objects_scene(4, 60)
    groups = MappingProxyType({"group": made.labels.astype(np.int32)})
    with tempfile.TemporaryDirectory(prefix="gaga-machine-") as name:
        write_splats(Path(name) / "a.ply", replace(made.gaussians, extra=groups))
        write_splats(Path(name) / "more.ply", random_gaussians(40, sh_degree=1))
        return {file.name: file.read_bytes() for file in Path(name).iterdir()}


class SessionMachine(RuleBasedStateMachine):
    """One person at the program, who also loses power."""

    n_commands = 0  # that were applied, of all machines of the process
    n_damaged: ClassVar[Counter[str]] = Counter()  # what became of damaged files

    @initialize()
    def begin(self) -> None:
        self.folder = Path(tempfile.mkdtemp(prefix="gaga-machine-"))
        self._home = os.environ.get("GAGA_HOME")
        os.environ["GAGA_HOME"] = str(self.folder / "home")
        for name, content in _good_files().items():
            (self.folder / name).write_bytes(content)
        self.kept: _Kept | None = None  # what the autosave on disk was made of
        self.place = self.folder / "a.ply"  # what a new program opens
        self._start()
        self.session.open(self.place)
        self._opened()
        self.saved = snapshot(self.scene)  # what is in that place
        self.state = 0  # of the history after the last step
        self.is_applied = False  # whether this step did something, even if the state is as before

    def teardown(self) -> None:
        if not hasattr(self, "session"):
            return
        self.saver.finish()
        self.session.shut_down()
        shutil.rmtree(self.folder)
        if self._home is None:
            del os.environ["GAGA_HOME"]
        else:
            os.environ["GAGA_HOME"] = self._home

    # --- edits

    @rule(name=st.sampled_from(COMMANDS))
    def command(self, name: str) -> None:
        self.is_applied = commands.run(name, self.session)
        self._settle()

    @rule(at=st.integers(0, 9), how=st.sampled_from(["set", "add", "remove", "intersect"]))
    def select(self, at: int, how: edits.How) -> None:
        selection.select_groups(self.session, (self._group(at),), how)

    @rule(by=st.tuples(*[st.floats(-2, 2, width=32)] * 3), keeps=st.booleans())
    def drag(self, by: tuple[float, float, float], keeps: bool) -> None:
        if not len(self.session.selected_indices()):
            return
        for part in (0.5, 1.0):
            matrix = np.c_[np.eye(3), part * np.array(by)]
            transform.preview_move(self.session, matrix)
        (Session.commit_preview if keeps else Session.cancel_preview)(self.session)

    @rule(rgb=st.tuples(*[st.floats(0, 1, width=32)] * 3), opacity=st.floats(0, 1, width=32))
    def recolor(self, rgb: tuple[float, float, float], opacity: float) -> None:
        transform.recolor(self.session, rgb, opacity)

    @rule(at=st.integers(0, 9), name=st.text(max_size=12))
    def rename(self, at: int, name: str) -> None:
        objects.rename(self.session, self._group(at), name)

    @rule(at=st.integers(0, 9), rgb=st.none() | st.tuples(*[st.floats(0, 1, width=32)] * 3))
    def color_in_the_list(self, at: int, rgb: tuple[float, float, float] | None) -> None:
        objects.set_color(self.session, self._group(at), rgb)

    @rule(at=st.integers(0, 9), parent=st.integers(0, 9))
    def put_under(self, at: int, parent: int) -> None:
        folders.put_under(self.session, self._group(parent), (self._group(at),))

    @rule(at=st.integers(0, 9))
    def assign(self, at: int) -> None:
        objects.assign(self.session, self._group(at))

    @rule(name=st.sampled_from("abc"), forgets=st.booleans())
    def name_selection(self, name: str, forgets: bool) -> None:
        change = selection.forget_named if forgets else selection.keep_selection
        change(self.session, name)

    @rule(seed=st.integers(0, 99))
    def associate(self, seed: int) -> None:
        """What an association gives, of labels that only a seed knows."""
        rng, n = np.random.default_rng(seed), len(self.scene)
        log = (Decision("a.jpg", seed, 1, True, 0.5, 0, 0.0, 9),)
        bank = MemoryBank(
            rng.integers(-1, 4, self.scene.n_opened, np.int32), 4, log, preset="paper"
        )
        labels = rng.integers(0, 5, n, np.int32)
        confidence = rng.random(self.scene.n_opened).astype(np.float32)
        document = self.session.need()
        edit = edits.set_grouping(document.settled().scene, labels, bank, confidence=confidence)
        document.do(edit)

    @rule()
    def add_splats(self) -> None:
        if len(self.scene) < MOST_SPLATS:
            files.add_splats(self.session, self.folder / "more.ply")
            self._settle()

    # --- history

    @rule(back=st.booleans(), times=st.integers(1, 4))
    def undo_or_redo(self, back: bool, times: int) -> None:
        for _ in range(times):
            (Session.undo if back else Session.redo)(self.session)
            self._same_as_before()

    @rule(share=st.floats(0, 1))
    def go_to(self, share: float) -> None:
        document = self.session.need()
        document.go_to(int(share * len(document.history.entries())))

    # --- files

    @rule(elsewhere=st.booleans())
    def save(self, elsewhere: bool) -> None:
        target = self.folder / "else.gaga" if elsewhere else None
        self.session.save(target)
        self._settle()
        assert not self.session.unsaved, self._texts()
        path = self.session.need().project.path
        assert path is not None
        self.place, self.saved, self.is_applied = path, snapshot(self.scene), True

    @rule()
    def reopen(self) -> None:
        self.session.close()
        if self.session.pending_question is not None:
            self.session.answer("Discard")
        self._tick()
        self.session.open(self.place)
        self._opened()
        assert snapshot(self.scene) == self.saved
        assert not self.session.unsaved
        self.is_applied = True

    @rule()
    def autosave(self) -> None:
        document, before = self.session.need(), self._autosaved()
        self.saver._next = 0.0
        self._tick()
        self.saver._next = time.monotonic() + _NEVER_S
        if self._autosaved() not in (before, ""):
            self.kept = _Kept(
                tuple(self.states[state] for state in document.history.state_ids),
                document.history.cursor,
                tuple(entry.title for entry in document.history.entries()),
            )
            self.is_applied = True

    @rule()
    def lose_power(self) -> None:
        """The program ends at once; the next one recovers, or opens what was saved."""
        self._end()
        assert autosave.offer(self.session) == (self.kept is not None)
        if self.kept is None:
            self._open_saved()
            return
        self.session.answer("Recover")
        self._opened()
        assert self.session.unsaved
        self._walk(self.kept)

    @rule(seed=st.integers(0, 1 << 40))
    def damage_the_autosave(self, seed: int) -> None:
        """The program ends, and its autosave is not as it was written."""
        if not self.session.unsaved:
            commands.run("camera.add_bookmark", self.session)
        self.autosave()
        if self.kept is None:
            return
        folder = next(autosave.root().iterdir())
        names = [path.name for path in folder.iterdir() if path.suffix in (".npz", ".json")]
        names = [name for name in names if name != "recovery.json"] + [autosave.FILE] * 4
        self._end()
        self._damage(folder, names, seed)
        assert autosave.offer(self.session)
        self.session.answer("Recover")
        self._settle()
        if not self._is_open("autosave"):
            shutil.rmtree(folder)
            self.kept = None
            self._open_saved()
            return
        self._opened()
        self.kept = self._found()

    @rule(seed=st.integers(0, 1 << 40))
    def open_a_damaged_project(self, seed: int) -> None:
        """What was saved is opened in a copy of another maker."""
        if self.place.suffix != ".gaga":
            self.save(elsewhere=True)
        copy = self.folder / f"damaged {len([*self.folder.glob('damaged *')])}.gaga"
        shutil.copytree(self.place, copy, ignore=shutil.ignore_patterns(LOCK, OWNER))
        self._damage(copy, [path.name for path in copy.iterdir() if path.is_file()], seed)
        self._end()
        self._remove_autosaves()
        self.session.open(copy)
        self._settle()
        if not self._is_open("project") or any("read-only" in text for text in self._texts()):
            self._open_saved()
            return
        self._opened()
        self.place, self.saved = copy, snapshot(self.scene)

    def _end(self) -> None:
        """End the program as a loss of power does, and start the next one."""
        self.is_applied = True
        self.session.shut_down()  # of its threads nothing is left either
        self.saver._writer.shutdown()
        for note in autosave.root().glob("*/recovery.json"):
            content = json.loads(note.read_text())
            note.write_text(json.dumps(content | {"pid": _ended_process()}))
        self._start()

    def _open_saved(self) -> None:
        self.session.open(self.place)
        self._opened()
        assert self.session.project is not None
        assert self.place in (self.session.project.path, self.session.project.model_path)
        assert snapshot(self.scene) == self.saved

    def _remove_autosaves(self) -> None:
        shutil.rmtree(autosave.root(), ignore_errors=True)
        self.kept = None

    def _damage(self, folder: Path, names: list[str], seed: int) -> None:
        """Change one of the files ``names`` of ``folder`` by a rule of its format, or bytes."""
        rng = random.Random(seed)
        outside = Path(tempfile.mkdtemp(prefix="outside-", dir=self.folder))
        victim = folder / rng.choice(sorted(names))
        if rng.random() < 0.8:
            changed(victim, folder, outside, rng)
        else:
            victim.write_bytes(mutated(victim.read_bytes(), rng))

    def _is_open(self, what: str) -> bool:
        """Whether damaged files were opened; a person is told where not."""
        is_open = self.session.document is not None
        SessionMachine.n_damaged[f"{what} {'opened' if is_open else 'refused'}"] += 1
        assert is_open or self._texts()
        return is_open

    def _found(self) -> _Kept:
        """The states of the history as it came back, there and back the same."""
        document = self.session.need()
        history, entries = document.history, document.history.entries()
        cursor, states = history.cursor, []
        for place in range(len(entries) + 1):
            document.go_to(place)
            states.append(snapshot(document.scene))
        kept = _Kept(tuple(states), cursor, tuple(entry.title for entry in entries))
        document.go_to(cursor)
        self._walk(kept)
        return kept

    # --- always

    @invariant()
    def same_as_before(self) -> None:
        if hasattr(self, "session"):
            state = self.session.need().history.state_id
            SessionMachine.n_commands += self.is_applied or state != self.state
            self.state, self.is_applied = state, False
            self._same_as_before()
            self._tick()
            for text in self._texts():
                assert not _WRONG.search(text), text
                assert text.isprintable()
                assert len(text) <= LONGEST_SENTENCE
            while len(self.scene) > MOST_SPLATS and self.session.undo() is not None:
                pass

    def _same_as_before(self) -> None:
        document = self.session.need()
        history = document.history
        new = [i for i, state in enumerate(history.state_ids) if state not in self.states]
        for cursor in (*new, history.cursor) if len(new) > 1 else (history.cursor,):
            document.go_to(cursor)  # a command may be several edits
            now = snapshot(self.scene)
            assert self.states.setdefault(history.state_id, now) == now

    def _walk(self, kept: _Kept) -> None:
        """Undo and redo everything that came back."""
        document = self.session.need()
        entries = document.history.entries()
        assert tuple(entry.title for entry in entries) == kept.titles
        assert document.history.cursor == kept.cursor
        for cursor in (kept.cursor, *range(len(entries) + 1), kept.cursor):
            document.go_to(cursor)
            assert snapshot(document.scene) == kept.states[cursor]
        self.states.update(zip(document.history.state_ids, kept.states, strict=True))

    # --- the program

    @property
    def scene(self) -> Scene:
        assert self.session.scene is not None, self._texts()
        return self.session.scene

    def _start(self) -> None:
        self.session = new_session(Settings(preset="paper", identities="none"))
        self.saver = autosave.Autosave(_NEVER_S)

    def _opened(self) -> None:
        self._settle()
        ids = self.session.need().history.state_ids
        now = {} if len(ids) > 1 else {0: snapshot(self.scene)}  # with more it is recovered
        self.states: dict[int, Snapshot] = now

    def _settle(self) -> None:
        assert self.session.jobs.wait()
        if self.session.pending_question is not None:
            self.session.answer(self.session.pending_question.choices[-1])
        self.session.take_request()

    def _tick(self) -> None:
        """A frame of the window, as far as the autosave sees it."""
        self.saver.tick(self.session)
        self.saver.wait()
        self.saver.tick(self.session)
        self.saver.wait()
        if not self._autosaved():
            self.kept = None

    def _autosaved(self) -> str:
        """The scene file of the autosave on disk, if there is one."""
        root = autosave.root()
        found = [saved_scene(folder) for folder in root.iterdir()] if root.exists() else []
        return next(iter(found), "")

    def _group(self, at: int) -> int:
        groups = [int(group) for group in self.session.objects().ids if group > 0]
        return groups[at % len(groups)] if groups else 1

    def _texts(self) -> list[str]:
        return [notice.text for notice in self.session.notices]
