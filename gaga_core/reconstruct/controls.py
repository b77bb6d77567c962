"""Options that messages advise: what they are called in the command and in the window.

The window's names are those of its sheet "Make splats" (Settings next to the offer).
"""

IN_WINDOW = {
    "--quality": "Quality",
    "--focal": "Focal length, pixels",
    "--video-fps": "Frames of each second",
    "--foreground": "Masks of the object",
    "--turntable": "Object on a turntable",
    "--scene": "Scene",
    "--place-minutes": "Minutes for placing",
}


def option(name: str, value: str = "") -> str:
    """``name`` with its control: "--quality standard (Quality in the window's settings)"."""
    shown = f"{name} {value}".strip()
    return f"{shown} ({IN_WINDOW[name]} in the window's settings)"
