"""Pages with one viewer: served by a local program, or complete in one file."""

import base64
import html
import json

from lf_flame._common.input_files import printable
from lf_flame.viewer.coded_views import deflated
from lf_flame.viewer.exhibit import Exhibit
from lf_flame.viewer.preview import shrink
from lf_flame.viewer.scripts import page_frame, read_static, script_url

SERVED_POLICY = (
    "default-src 'none'; script-src 'self'; style-src 'self'; img-src 'self' data:; "
    "connect-src 'self'; worker-src 'self'; base-uri 'none'; form-action 'none'; "
    "frame-ancestors 'none'"
)
"""Content security policy of the local page: requests only to the program itself."""

FILE_POLICY = (
    "default-src 'none'; script-src 'unsafe-inline' data:; style-src 'unsafe-inline'; "
    "img-src data: blob:; worker-src data:; base-uri 'none'; form-action 'none'"
)
"""Content security policy of a page in one file: no requests at all."""


def served_page(exhibit: Exhibit) -> str:
    """Make the page that requests views from the program that serves it."""
    metadata = exhibit.describe_served()
    return page_frame().substitute(
        title=html.escape(printable(exhibit.title)),
        description=html.escape(describe(metadata)),
        policy="",
        style='<link rel="stylesheet" href="static/viewer.css">',
        data=_json_block(metadata),
        script='<script type="module" src="static/page.js"></script>',
    )


def single_page(exhibit: Exhibit, most_bytes: int) -> tuple[str, str]:
    """Make a page that contains all its data, and sends no requests; also say how exact it is.

    Views that need more than `most_bytes` are stored less exactly, or fewer of them; if even a few
    coarse ones are too large, that is refused.
    """
    slope_map = deflated(exhibit.map_bytes()) if exhibit.with_map else b""
    script = f'<script type="module">import "{script_url("page.js")}";</script>'
    style = read_static("viewer.css")
    carried = len(script) + len(style) + _base64_length(slope_map) + 8192
    is_stack = exhibit.depths_mm is not None
    shrunk = shrink(exhibit.coded, most_bytes, carried, exact=is_stack)
    metadata = exhibit.describe(shrunk.coded, shrunk.pieces, shrunk.coding)
    blocks = [_json_block(metadata)]
    blocks += [_data_block(f"lf-piece-{k}", data) for k, data in enumerate(shrunk.data)]
    if slope_map:
        blocks.append(_data_block("lf-map", slope_map))
    page = page_frame().substitute(
        title=html.escape(printable(exhibit.title)),
        description=html.escape(describe(metadata, shrunk.quality)),
        policy=f'<meta http-equiv="Content-Security-Policy" content="{FILE_POLICY}">',
        style=f"<style>{style}</style>",
        data="\n".join(blocks),
        script=script,
    )
    return page, shrunk.quality


def describe(metadata: dict, quality: str = "") -> str:
    """Describe the views in one line."""
    (v, u), (t, s) = metadata["views"], metadata["size"]
    if metadata["depths_mm"]:
        first, last = metadata["slopes"]
        depths = f"from {first:g} to {last:g} mm"
        return f"{u} planes of {t} × {s} cells, {depths}: light that each plane adds"
    kind = "grey" if metadata["channels"] == 1 else "colour"
    return f"{v} × {u} views of {t} × {s} pixels, {kind}" + (f"; {quality}" if quality else "")


def _base64_length(data: bytes) -> int:
    return -(-len(data) // 3) * 4


def _json_block(metadata: dict) -> str:
    """Script block with JSON in which no text can end the block."""
    text = json.dumps(metadata).replace("<", "\\u003c")
    return f'<script type="application/json" id="lf-metadata">{text}</script>'


def _data_block(name: str, data: bytes) -> str:
    text = base64.b64encode(data).decode()
    return f'<script type="text/plain" id="{name}">{text}</script>'
