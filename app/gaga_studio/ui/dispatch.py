"""Every dialog of the window registers itself for the request that it answers."""

from gaga_studio.ui.chrome import command_buttons
from gaga_studio.ui.dialogs import (
    add_views,
    export,
    film_and_picture,
    find_objects,
    make_masks,
    models,
    open_and_save,
    preferences,
    reduce,
    sheets,
)
from gaga_studio.ui.kit.requests import RequestTable
from gaga_studio.ui.panels import bank_timeline, objects, search
from gaga_studio.ui.state import UiState
from gaga_studio.ui.viewport import training


def request_table(ui: UiState) -> RequestTable:
    """The answers to all requests. State of a scene is looked up when a request comes."""
    table = RequestTable()
    sheets.register(table, ui.palette)
    preferences.register(table)
    command_buttons.register(table)
    training.register(table)
    export.register(table, ui.export)
    film_and_picture.register(table)
    make_masks.register(table)
    find_objects.register(table)
    add_views.register(table)
    models.register(table)
    reduce.register(table, ui.reduce)
    open_and_save.register(table, ui.files)
    objects.register(table, lambda: ui.scene.objects)
    bank_timeline.register(table)
    search.register(table, lambda: ui.scene.objects.search, ui.area)
    return table
