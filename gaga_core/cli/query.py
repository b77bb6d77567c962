"""``gaga query``: which groups a text means."""

from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING

from tyro.conf import Positional

from gaga_core.cli import output as out
from gaga_core.cli.output import AsJson
from gaga_core.errors import GagaError, counted

if TYPE_CHECKING:
    from gaga_core.camera import Camera
    from gaga_core.pipeline.search import Pictures
    from gaga_core.query.embed import Embedder
    from gaga_core.query.search import Answer
    from gaga_core.scene.project import Project


@dataclass(frozen=True)
class QueryCommand:
    """Find groups by name, color, size, place, or meaning: "the largest red one"."""

    scene: Positional[Path]
    """Scene folder with groups, .ply file with a group column, or saved project."""
    text: Positional[str] = ""
    """What to look for."""
    index_with: str | None = None
    """Folder of a CLIP or SigLIP model, or clip-base, clip-large, siglip-base, siglip2-base: index
    the groups' pictures, so that any noun is found."""
    in_view: str | None = None
    """View whose left and right are meant; with --detector, the view to look in."""
    detector: str | None = None
    """Folder of a Grounding DINO or OWLv2 model, or grounding-dino-tiny, grounding-dino-base,
    owlv2-base: find the text in the view given by --in-view."""
    top: int = 5
    """How many groups to print."""
    name_groups: bool = False
    """Name groups that have no name, from a list of nouns and the index, and save the project."""
    json: AsJson = False

    def run(self) -> int:
        """Print the groups that are meant, the best first, and what was understood."""
        from gaga_core.pipeline import search
        from gaga_core.pipeline.search import describe_project

        self._check()
        project = out.open_project(self.scene)
        if not (project.scene.labels > 0).any():
            raise GagaError(f"{self.scene} has no groups yet. Associate the masks first.")
        pictures = self._pictures(project)
        values: dict[str, object] = {}
        if self.name_groups:
            assert pictures is not None
            values["named"] = self._named(project, pictures)
        if not self.text:
            return out.result(values, as_json=self.json)
        view = self._view(project)
        if self.detector is not None:
            from gaga_core.query.detector import load_detector
            from gaga_core.query.embed import KNOWN_DETECTORS, folder_of

            assert view is not None
            detector = load_detector(folder_of(self.detector, KNOWN_DETECTORS))
            stage = search.find_in_view(project.scene, [view], self.text, detector)
            answer = out.follow(stage, compiles=True)
        else:
            views = search.train_views(project)
            describe_project(project)
            words = search.search_stage(
                project.scene, self.text, cameras=views, camera=view, pictures=pictures
            )
            answer = out.follow(words, compiles=True)
            if answer.unknown and pictures is None:
                out.say("Index it with --index-with clip-base, or another CLIP or SigLIP.")
        self._print(project, answer, values)
        return 0

    def _check(self) -> None:
        if not self.text and not self.name_groups:
            raise GagaError('Say what to look for: gaga query SCENE "the largest red one".')
        if self.detector is not None and self.in_view is None:
            raise GagaError("--detector looks in one view. Name it with --in-view.")

    def _pictures(self, project: "Project") -> "Pictures | None":
        """The index, brought up to date when a model is given."""
        from gaga_core.pipeline import search

        def load() -> "Embedder":
            from gaga_core.query.embed import KNOWN_EMBEDDERS, folder_of, load_embedder

            if self.index_with is None:
                raise GagaError(
                    "This text is new to the index. Name the model that made it with --index-with."
                )
            return load_embedder(folder_of(self.index_with, KNOWN_EMBEDDERS))

        if self.index_with is not None:
            embedder = load()
            out.follow(search.refresh_index(project, embedder), compiles=True)
            return search.pictures_of(project, lambda: embedder)
        found = search.pictures_of(project, load)
        if found is None and self.name_groups:
            raise GagaError("Names come from an index. Give a CLIP or SigLIP with --index-with.")
        stale = 0 if found is None else search.stale_groups(project.scene, found.index)
        if stale:
            groups = counted(stale, "group")
            out.say(f"{groups} changed since the index was made: give --index-with again.")
        return found

    def _named(self, project: "Project", pictures: "Pictures") -> dict[str, str]:
        """Name what is sure, in the saved project."""
        from gaga_core.pipeline import search
        from gaga_core.scene.edits import rename
        from gaga_core.scene.edits.history import History
        from gaga_core.scene.project import save_project

        history = History(project.scene)
        names = search.suggested_names(project.scene, pictures)
        for group, name in names.items():
            edit = rename(project.scene, group, name, "Name objects")
            if edit is not None:
                history.do(edit)
        if names:
            save_project(project)
        return {str(group): name for group, name in names.items()}

    def _view(self, project: "Project") -> "Camera | None":
        from gaga_core.io.folder.scene_folder import select_views

        if self.in_view is None:
            return None
        folder = project.placed_folder
        if folder is None:
            raise GagaError("--in-view needs the views of a scene folder. Give that.")
        return select_views(folder, [self.in_view])[0]

    def _print(self, project: "Project", answer: "Answer", values: dict[str, object]) -> None:
        from gaga_core.scene.objects import group_name

        rows = [
            {
                "group": int(g),
                "name": group_name(project.scene, int(g)),
                "score": round(float(s), 4),
            }
            for g, s in zip(answer.groups[: self.top], answer.scores, strict=False)
        ]
        if self.json:
            found = {"text": self.text, "sentence": answer.sentence, "groups": rows}
            unknown = {"meant": answer.n_meant, "not_understood": list(answer.unknown)}
            out.result({**values, **found, **unknown}, as_json=True)
            return
        out.say(answer.sentence)
        shown = {f"{row['group']}": f"{row['score']:.2f}  {row['name']}" for row in rows}
        out.result({**values, **shown}, as_json=False)
