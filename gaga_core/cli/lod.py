"""``gaga lod``: the tree of merged splats of a large scene, headless."""

from dataclasses import dataclass
from pathlib import Path

from tyro.conf import Positional

from gaga_core.cli import output as out


@dataclass(frozen=True)
class LodCommand:
    """Build the level of detail of a large scene, which the window draws it by."""

    scene: Positional[Path]
    """Scene folder, file of splats (.ply, .splat, .spz, .sog, .ksplat, .glb, .gltf) or
    saved project."""
    again: bool = False
    """Build it also when there is one of this model."""
    sog: Path | None = None
    """Folder to write the levels to as streamed SOG (lod-meta.json), which other viewers load."""
    json: bool = False
    """Print the result as JSON."""

    def run(self) -> int:
        """Write gaga/lod in the scene folder, or NAME.gaga/lod next to a file.

        Of a saved project to which files were added: lod-added there, of all of them.
        """
        from gaga_core.pipeline.level_of_detail import (
            build_project_lod_stage,
            open_project_lod,
            rows_of,
            rows_of_files,
        )
        from gaga_core.scene.lod.streamed import write_streamed_sog_stage
        from gaga_core.scene.project import open_path_stage

        project = out.follow(open_path_stage(self.scene))
        tree = None if self.again else open_project_lod(project)
        is_new = tree is None or len(tree) < rows_of_files(project.scene)
        if tree is None or is_new:
            tree = out.follow(build_project_lod_stage(project))
        values: dict[str, object] = {}
        if self.sog is not None:
            stage = write_streamed_sog_stage(self.sog, tree, rows_of(project, len(tree)))
            values["streamed_sog"] = str(out.follow(stage))
        out.result(
            {
                "folder": str(tree.folder),
                "built": is_new,
                "gaussians": len(tree),
                "levels": list(tree.sizes),
                "megabytes": round(tree.file_bytes / 1e6, 1),
                **values,
            },
            as_json=self.json,
        )
        return 0
