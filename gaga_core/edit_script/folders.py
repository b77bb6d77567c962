"""The operations of edit scripts on the order among objects: folders and parents."""

from typing import Annotated, TypeAlias

from msgspec import UNSET, Meta, UnsetType

from gaga_core.edit_script.base import Operation, groups_of, one_object_of
from gaga_core.edit_script.fields import Groups, Name, OneGroup
from gaga_core.errors import GagaError
from gaga_core.scene import edits
from gaga_core.scene.edits import Edit
from gaga_core.scene.scene import Scene

Path = Annotated[str, Meta(max_length=2000, description='a text such as "Kitchen/Cups"')]


class NewFolder(Operation, frozen=True):
    """Make an empty folder."""

    folder: Path

    def edit(self, scene: Scene) -> Edit | None:
        return edits.new_folder(scene, self.folder)


class PutInFolder(Operation, frozen=True):
    """Put objects into a folder, which is made if it is not there; "" takes them out of all."""

    folder: Path
    groups: Groups | UnsetType = UNSET

    def edit(self, scene: Scene) -> Edit | None:
        groups = groups_of(scene, self.groups)
        if not groups:
            raise GagaError('no object is selected. Give "groups", or select first.')
        return edits.put_in_folder(scene, groups, self.folder)


class MoveFolder(Operation, frozen=True):
    """Put a folder into another one; "" takes it out of all."""

    folder: Path
    into: Path = ""

    def edit(self, scene: Scene) -> Edit | None:
        return edits.put_in_folder(scene, (), self.into, (self.folder,), "Move folder")


class RenameFolder(Operation, frozen=True):
    """Give a folder another name."""

    folder: Path
    name: Name

    def edit(self, scene: Scene) -> Edit | None:
        return edits.rename_folder(scene, self.folder, self.name)


class DeleteFolder(Operation, frozen=True):
    """Take a folder away; what is in it goes into the folder that it was in."""

    folder: Path

    def edit(self, scene: Scene) -> Edit | None:
        return edits.delete_folder(scene, self.folder)


class SetParent(Operation, frozen=True):
    """Put objects under another object; what lies under them goes along."""

    parent: OneGroup
    groups: Groups | UnsetType = UNSET

    def edit(self, scene: Scene) -> Edit | None:
        groups = groups_of(scene, self.groups)
        if not groups:
            raise GagaError('no object is selected. Give "groups", or select first.')
        return edits.set_parent(scene, groups, one_object_of(scene, (self.parent,)))


class LeaveParent(Operation, frozen=True):
    """Take objects out from under the object that they lie under, to where that is."""

    groups: Groups | UnsetType = UNSET

    def edit(self, scene: Scene) -> Edit | None:
        return edits.leave_parent(scene, groups_of(scene, self.groups))


FolderOperation: TypeAlias = (
    NewFolder | PutInFolder | MoveFolder | RenameFolder | DeleteFolder | SetParent | LeaveParent
)
