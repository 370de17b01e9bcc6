"""Data that a page requests from its program by name: views or planes, slices, the slope map."""

from collections.abc import Callable
from functools import partial
from threading import Lock

from lf_flame.viewer.coded_views import cut_into_pieces, piece_bytes
from lf_flame.viewer.exhibit import Exhibit
from lf_flame.viewer.planes import parse_place, parse_plane


class PageData:
    """Answers to the requests of an exhibit's pages; all names are known before the first request.

    Parameters
    ----------
    exhibit : Exhibit

    Attributes
    ----------
    questions : mapping of str to callable
        Functions of a query by name: ``plane`` and ``slices``, if the program refocuses.
    """

    def __init__(self, exhibit: Exhibit):
        self._exhibit = exhibit
        self._map_lock = Lock()
        self._names: dict[str, Callable[[], bytes]] = {}
        self.questions: dict[str, Callable[[str], bytes]] = {}
        if exhibit.why_planes:
            self._names["middle"] = lambda: exhibit.planes.middle().astype("<f4").tobytes()
            self.questions = {"plane": self._plane, "slices": self._slices}
        else:
            for number, piece in enumerate(cut_into_pieces(exhibit.coded)):
                self._names[f"views/{number}"] = partial(self._views, piece)
        if exhibit.with_map:
            self._names["map"] = self._slope_map

    def find(self, name: str, query: str = "") -> Callable[[], bytes] | None:
        """Find the function that makes the answer to a name; None for an unknown name.

        The function raises InputError if the answer cannot be made, or a query cannot be used.
        """
        if name in self.questions:
            return partial(self.questions[name], query)
        return self._names.get(name)

    def _views(self, piece: tuple[int, int]) -> bytes:
        return piece_bytes(self._exhibit.coded, piece)

    def _plane(self, query: str) -> bytes:
        """Radiance in float32, little-endian, shape (t / block, s / block, channels)."""
        return self._exhibit.planes.make(parse_plane(query)).astype("<f4").tobytes()

    def _slices(self, query: str) -> bytes:
        """Two slices in float32, little-endian, one after the other."""
        slices = self._exhibit.planes.slices(*parse_place(query))
        return b"".join(x.astype("<f4").tobytes() for x in slices)

    def _slope_map(self) -> bytes:
        with self._map_lock:  # computed once, however many pages request it
            return self._exhibit.map_bytes()
