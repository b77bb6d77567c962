"""Builders of edits: each reads the scene and returns the edit, or None if nothing would change.

Nothing here changes a scene; `gaga_core.scene.edits.history.History.do` does. ``indices`` are rows
(K,) in any order, or a mask (N,) bool. Modules named after a topic build edits; modules whose name
ends in ``values`` hold the edits themselves.
"""

from gaga_core.scene.edits.append import append
from gaga_core.scene.edits.duplicate import duplicate, free_group
from gaga_core.scene.edits.folders import (
    delete_folder,
    moved_folders,
    new_folder,
    put_in_folder,
    rename_folder,
)
from gaga_core.scene.edits.frame import move_scene, set_origin, set_scale
from gaga_core.scene.edits.groups import merge_groups, rename, set_color, set_grouping, set_labels
from gaga_core.scene.edits.identities import set_identities, use_labels
from gaga_core.scene.edits.levels import join_here, split_here
from gaga_core.scene.edits.named_selections import forget_selection, keep_selection, named_selection
from gaga_core.scene.edits.parents import leave_parent, set_parent
from gaga_core.scene.edits.placement import recolor, reset_placement, transform
from gaga_core.scene.edits.split import separate, split, split_off
from gaga_core.scene.edits.state import (
    How,
    delete,
    hide,
    isolate,
    lock,
    restore,
    select,
    set_state,
    show,
    show_all,
    unlock,
)
from gaga_core.scene.edits.values import Edit, Edits, together

__all__ = [
    "Edit",
    "Edits",
    "How",
    "append",
    "delete",
    "delete_folder",
    "duplicate",
    "forget_selection",
    "free_group",
    "hide",
    "isolate",
    "join_here",
    "keep_selection",
    "leave_parent",
    "lock",
    "merge_groups",
    "move_scene",
    "moved_folders",
    "named_selection",
    "new_folder",
    "put_in_folder",
    "recolor",
    "rename",
    "rename_folder",
    "reset_placement",
    "restore",
    "select",
    "separate",
    "set_color",
    "set_grouping",
    "set_identities",
    "set_labels",
    "set_origin",
    "set_parent",
    "set_scale",
    "set_state",
    "show",
    "show_all",
    "split",
    "split_here",
    "split_off",
    "together",
    "transform",
    "unlock",
    "use_labels",
]
