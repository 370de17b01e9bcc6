"""The page's scripts and styles, as files of the package and linked into one text."""

import base64
import re
from functools import cache
from importlib.resources import files
from string import Template

STATIC = files("lf_flame.viewer") / "static"

IMPORTED = re.compile(r'"\./([a-z_]+\.js)"')
"""Pattern of a script's name in another script."""

MEDIA_TYPES = {".js": "text/javascript", ".css": "text/css"}


@cache
def read_static(name: str) -> str:
    """Read the text of a script, of the style sheet or of the page's frame."""
    return (STATIC / name).read_text(encoding="utf-8")


def static_names() -> list[str]:
    """List the names of the scripts and the style sheet."""
    return sorted(x.name for x in STATIC.iterdir() if x.name.endswith(tuple(MEDIA_TYPES)))


@cache
def linked_script(name: str) -> str:
    """Text of a script with each imported script replaced by its data: URL.

    A page in one file, or a notebook, therefore runs the same modules as the local page.
    """
    return IMPORTED.sub(lambda found: f'"{script_url(found[1])}"', read_static(name))


@cache
def script_url(name: str) -> str:
    """Make the data: URL of a linked script."""
    text = base64.b64encode(linked_script(name).encode()).decode()
    return f"data:text/javascript;base64,{text}"


@cache
def page_frame() -> Template:
    """Read the template of a page."""
    return Template(read_static("page.html"))
