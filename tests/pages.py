"""What a web page of a scene holds, read back without a browser."""

import base64
import gzip
import json
import re
from pathlib import Path
from typing import Any


def page_data(path: Path) -> tuple[dict[str, Any], dict[str, bytes]]:
    """The JSON of a page, and its columns by name."""
    text = path.read_text(encoding="utf-8")
    found = dict(re.findall(r'<script type="text/plain" id="([\w-]+)">([^<]*)</script>', text))
    scene = json.loads(found.pop("scene"))
    return scene, {name: gzip.decompress(base64.b64decode(part)) for name, part in found.items()}
