"""The operations of edit scripts whose edit is computed from the splats: these take seconds."""

from typing import TypeAlias

from msgspec import UNSET

from gaga_core.edit_script.base import OnGroups, OnSplats, Views, groups_of
from gaga_core.edit_script.fields import Digest, FilePath, Flag, Share
from gaga_core.errors import GagaError
from gaga_core.progress import run_stage
from gaga_core.scene.cleanup import clean_objects_stage, relabel
from gaga_core.scene.edits import Edit
from gaga_core.scene.scene import Scene


class Clean(OnGroups, frozen=True):
    """Clean up, as in the window."""

    def edit(self, scene: Scene) -> Edit | None:
        groups = groups_of(scene, self.groups)
        if not groups:
            raise GagaError('no object is selected. Give "groups".')
        return relabel(scene, run_stage(clean_objects_stage(scene, groups)))


class Fill(OnSplats, frozen=True):
    """Delete and fill what was hidden; without groups and selection: fill where was deleted."""

    lighten: Flag = True  # take its shadow off what it stood on
    model: FilePath = ""  # of an inpainting model that colors the hole
    sha256: Digest = ""  # of that file; another one is refused

    def edit(self, scene: Scene) -> Edit | None:
        return self.edit_seen(scene, tuple)

    def edit_seen(self, scene: Scene, views: Views) -> Edit | None:
        # SciPy's and numba's import takes long: only where something is filled.
        from gaga_core.fill.fill import fill_stage, fill_title, fillable, filled_edit
        from gaga_core.fill.surfaces import FillConfig
        from gaga_core.raster import choose

        splats = fillable(scene) if self.groups is UNSET else self.splats(scene)
        if self.sha256 and not self.model:
            raise GagaError('"sha256" is that of a model: give "model", too.')
        config = FillConfig(lighten=self.lighten, model=self.model, model_sha256=self.sha256)
        found = run_stage(fill_stage(scene, splats, views(), choose(), config))
        return filled_edit(scene, found, fill_title(scene, splats))


class Reduce(OnSplats, frozen=True):
    """Merge neighbours that are alike until a share of the splats is left."""

    share: Share

    def edit(self, scene: Scene) -> Edit | None:
        return self.edit_seen(scene, tuple)

    def edit_seen(self, scene: Scene, views: Views) -> Edit | None:
        # SciPy's and numba's import takes long: only where something is merged.
        from gaga_core.raster import choose
        from gaga_core.scene.reduce import reduce_stage, reduce_title, reduced_edit

        if self.share == 0:
            raise GagaError('"share" must be above 0: it is the share of the splats that is kept.')
        splats = self.splats(scene)
        found = run_stage(reduce_stage(scene, splats, self.share, views(), choose()))
        return reduced_edit(scene, found, reduce_title(scene, splats, found))


ComputedOperation: TypeAlias = Clean | Fill | Reduce
