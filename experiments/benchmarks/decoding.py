"""How fast raw images are decoded: against the memory's rate, and other programs on the same image.

    make benchmarks

All calls of an image are timed in turn. The floor reads the raw image once and writes the views
once. The strongest simple rival, SciPy's map_coordinates, interpolates at the middle of each part
of a micro-image. PlenoptiCam, where `baselines.txt` is installed (`--baselines`), resamples each
micro-image at its centre; it divides by no white image here, and decodes no mosaic of colours.
"""

from dataclasses import dataclass
from functools import partial

import numpy as np
from scipy import ndimage

from experiments.benchmarks.report import OtherPython, finish, ratio, run_cases
from experiments.timing import in_turn, seconds
from lf_flame._common.arrays import centred
from lf_flame.formats import DecodePlan, LensletGrid

COLUMNS = {
    "what": ("what", ""),
    "baseline": ("baseline", ""),
    "plan s": ("plan s", ".2g"),
    "ours ms": ("ours ms", ".4g"),
    "baseline ms": ("baseline ms", ".4g"),
    "ratio": ("ratio", ".3g"),
    "quartiles": ("quartiles", ""),
    "wanted": ("wanted", ""),
    "correlation": ("correlation", ""),
    "remarks": ("remarks", ""),
}

PLENOPTICAM = "PlenoptiCam"


@dataclass(frozen=True)
class Case:
    """A raw image, its lenslets, and the time that is wanted in ms."""

    what: str
    shape: tuple[int, int]
    grid: LensletGrid
    views: int
    bayer: str | None = None
    others: bool = True
    wanted_ms: float | None = None

    def picture(self) -> np.ndarray:
        """Smooth texture seen through the lenslets, 12 bits."""
        rng = np.random.default_rng(0)
        coarse = rng.uniform(300, 4000, [n // 16 + 2 for n in self.shape]).astype(np.float32)
        zoomed = ndimage.zoom(coarse, 16, order=1)[: self.shape[0], : self.shape[1]]
        return np.rint(zoomed).astype(np.uint16)


def cases(small: bool) -> list[Case]:
    """Everything that is measured, or the same with few pixels."""
    square = LensletGrid(50.3, 61.2, 10.03, 0.001)
    illum = LensletGrid(50.3, 61.2, 14.29, -0.0005, "hexagonal")
    if small:
        return [Case("small, grey", (160, 200), square, 9)]
    return [
        Case("1 megapixel, grey", (1024, 1024), square, 9),
        Case("4 megapixels, grey", (2048, 2048), square, 9, others=False, wanted_ms=40),
        Case(
            "41 megapixels, Bayer to 15 x 15 views", (5368, 7728), illum, 15, "grbg", others=False,
            wanted_ms=2000,
        ),
    ]  # fmt: skip


def copy(raw: np.ndarray, views: np.ndarray) -> None:
    """Read the raw image once, and write the views once."""
    raw.max()
    views.fill(1.0)


def by_scipy(raw: np.ndarray, places: np.ndarray, shape: tuple[int, ...]) -> np.ndarray:
    """Interpolate at the middle of each part of each micro-image, linearly."""
    found = ndimage.map_coordinates(raw, places, np.float32, order=1, mode="nearest")
    return found.reshape(shape)


def part_places(case: Case, rows: np.ndarray, columns: np.ndarray) -> np.ndarray:
    """Middles of the parts of all micro-images, shape (2, v, u, t, s)."""
    down, along = (
        centred(case.views) * step / case.views for step in (case.grid.row_pitch, case.grid.pitch)
    )
    y, x = case.grid.position(rows[:, None], columns[None, :])
    dy, dx = case.grid.turned(down[:, None], along[None, :])
    return np.stack([y + dy[:, :, None, None], x + dx[:, :, None, None]])


def measure(case: Case, small: bool, other: OtherPython | None) -> list[dict]:
    """Decode by every method, compare the views, then time all in turn."""
    raw = case.picture()
    white = np.full(raw.shape, 4000, np.uint16)
    plan = partial(DecodePlan, case.grid, shape=raw.shape, views=case.views, white=white)
    plan = partial(plan, bayer=case.bayer)
    decode = partial(plan().decode, raw)  # compiles
    plan_s = seconds(plan)
    views = decode().views
    found = {"floor": ("", "the raw image read and the views written once, by NumPy")}
    clocks = {
        "ours": partial(seconds, decode),
        "floor": partial(seconds, partial(copy, raw, np.empty_like(views))),
    }
    if case.others:
        rows, columns = case.grid.block(raw.shape)
        places = part_places(case, rows, columns)
        rival = partial(by_scipy, raw, places, views.shape[:4])
        found["SciPy map_coordinates"] = _likeness(rival(), views), "order 1, no white image"
        clocks["SciPy map_coordinates"] = partial(seconds, rival)
        if other and "plenopticam" in other.versions:
            centres = [
                [*case.grid.position(r, c), i, j]
                for i, r in enumerate(rows.tolist())
                for j, c in enumerate(columns.tolist())
            ]
            theirs = other.decode(raw, centres, case.views)
            found[PLENOPTICAM] = _likeness(theirs, views), "local resampling, linear"
            clocks[PLENOPTICAM] = partial(other.seconds, "decoding")
    rounds = 1 if small else 3
    times = in_turn(*clocks.values(), timed=True, rounds=rounds, turn_s=0.0)
    ours_ms, names, out = 1e3 * times.best[0], list(clocks), []
    row = {"what": f"{case.what}, {raw.shape[0]} x {raw.shape[1]}", "plan s": plan_s}
    row |= {"ours ms": ours_ms, "wanted": ""}
    for name, (alike, remarks) in found.items():
        at = names.index(name)
        measured = {"baseline ms": 1e3 * times.best[at], **ratio(times, at, 0)}
        out.append(row | {"baseline": name, **measured, "correlation": alike, "remarks": remarks})
    if case.wanted_ms:
        least = {"baseline": "wanted", "baseline ms": case.wanted_ms, "quartiles": ""}
        least |= {"ratio": case.wanted_ms / ours_ms, "wanted": "at least 1"}
        out.append(row | least | {"correlation": "", "remarks": ""})
    return out


def _likeness(theirs: np.ndarray, ours: np.ndarray) -> str:
    """Correlation of the views that both have, without their edges."""
    inner = (slice(1, -1), slice(1, -1), slice(2, -2), slice(2, -2))
    return f"{np.corrcoef(theirs[inner].ravel(), ours[inner].ravel())[0, 1]:.4f}"


def main() -> None:
    """Measure, print and write."""
    asked, record = run_cases(__doc__, cases, measure)
    notes = [
        "Ratio: the baseline's time over ours, median and quartiles of the rounds; times are the "
        "best of them, on all cores; a plan is made once for a camera. Correlation of the views "
        "with ours, on smooth texture."
    ]
    finish(asked.out, "decoding", "Speed of decoding raw images", record, COLUMNS, notes)


if __name__ == "__main__":
    main()
