"""What a command can ask of the window: a dialog, or that the keyboard goes somewhere."""

from enum import Enum, auto


class Request(Enum):
    """One request; exactly one dialog registers itself for each (`ui.kit.requests`)."""

    # Sheets and menus over the window.
    COMMAND_LIST = auto()
    SHORTCUTS = auto()
    ABOUT = auto()
    PREFERENCES = auto()
    MAKE_MASKS = auto()
    EXPORT_MASKS = auto()
    MODELS = auto()
    REDUCE = auto()
    FIND_OBJECTS = auto()
    ADD_VIEWS = auto()
    EXPORT_OBJECTS = auto()
    MAKE_SPLATS = auto()
    SAVE_FILM = auto()
    SAVE_PICTURE = auto()
    OBJECT_MENU = auto()  # of the object under the mouse
    SCENE_MENU = auto()  # where no object is under the mouse
    # A text field that takes the keyboard.
    RENAME = auto()
    FIND = auto()
    FIND_IN_VIEW = auto()  # the text that is there already
    # A panel that comes to the front.
    TIMELINE = auto()
    # A path of the file dialog.
    OPEN_FOLDER = auto()
    OPEN_FILE = auto()
    ADD_SPLATS = auto()
    IMPORT_MASK_FOLDER = auto()
    IMPORT_MASK_FILE = auto()
    SAVE_AS = auto()
    SAVE_SCRIPT = auto()
    EXPORT_SCENE = auto()
    EXPORT_PAGE = auto()
    EXPORT_MESHES = auto()
    EXPORT_SELECTED = auto()
    EXPORT_CAMERAS = auto()
    INPAINTING_MODEL = auto()
    OPEN_PATH = auto()  # of the camera
    SAVE_PATH = auto()
