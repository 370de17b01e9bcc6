"""Slopes from the costs of each pixel at each slope: semi-global matching, and votes of neighbours.

Along paths in eight directions the cost of a slope is its own plus that of the best path to it: a
change by one step costs a little, a jump costs more, and least across edges of a guide image
(Hirschmueller, IEEE Trans. Pattern Anal. Mach. Intell. 30, 328, 2008). The slope with the least sum
over the paths wins, refined by a parabola through the costs. Then each pixel takes the slope for
which most neighbours of similar brightness vote, as their mean (a weighted mode): this removes
single wrong slopes and averages noise, without inventing a surface halfway between two others.
The confidence is the agreement of the best slopes of single pixels around it: the depth of minima
says little, because outlines and highlights have deep ones, and smooth shading has none.

All loops gather in a fixed order; the bits do not depend on the number of threads.
"""

from itertools import product

import numpy as np

from lf_flame._common.threads import parallel

STEP, JUMP = 0.16, 0.6
"""Costs of a change of slope by one step of the search, and of a larger change."""

EDGE = 8.0
"""Change of brightness, times this, by which a jump costs less; all brightness is in standard
deviations of the guide image."""

ALIKE = 0.3
"""Difference of brightness at which a vote has half its weight."""

BENT = 1e-3
"""Smallest curvature of the costs at a best slope; in darkness without noise it is less."""

MUTE = 0.05
"""Weight of a vote for the first or last slope, or of a pixel without a best one."""

AGREEING = 0.3
"""Largest difference of slopes that agree, relative to the smallest that can be distinguished."""

SAME = 1.5
"""Largest difference of votes for the same slope, in steps of the search."""

REACH, FARTHEST = 1.6, 24
"""Largest distance of a voter along an axis, in the window's standard deviations and lenslets."""

DIRECTIONS = [(down, across) for down, across in product((-1, 0, 1), repeat=2) if down or across]
"""Steps (down, across) of the paths."""


def choose_slopes(
    costs: np.ndarray, slopes: np.ndarray, guide: np.ndarray, window: float, width: float
) -> tuple[np.ndarray, np.ndarray]:
    """Choose the slope of least costs[t, s, n] that a pixel's surroundings agree with.

    Edges of guide[t, s] stop smoothing; `width` is the largest difference of slopes that cannot be
    distinguished. Returns slope and confidence, which is 0 where the best slopes are the first or
    last, and everywhere without distinct slopes.
    """
    guide = in_deviations(guide)
    step = slopes[1] - slopes[0]
    place, inside = np.empty(guide.shape, np.float32), np.empty(guide.shape, bool)
    _pick(costs, sum_paths(costs, guide), place, inside)
    reach = min(int(np.ceil(REACH * window)), FARTHEST)
    near = np.exp(-((np.arange(reach + 1) / window) ** 2) / 2)
    voted, confidence = np.empty(guide.shape), np.empty(guide.shape)
    _vote(place, inside, guide, near, len(slopes), AGREEING * width / step, voted, confidence)
    if slopes[-1] - slopes[0] <= width:
        confidence[:] = 0
    return slopes[0] + step * voted, confidence


def in_deviations(guide: np.ndarray) -> np.ndarray:
    """Divide a guide image by its standard deviation."""
    scatter = float(guide.std(dtype=np.float64))  # whose squares float32 does not hold
    return (guide / max(scatter, np.finfo(np.float32).tiny)).astype(np.float32)


def sum_paths(costs: np.ndarray, guide: np.ndarray) -> np.ndarray:
    """Sum the costs along all paths: float32, shape (t, s, n)."""
    sums = np.zeros_like(costs)
    for way in DIRECTIONS:
        _add_paths(costs, guide, *way, sums)
    return sums


def _count_paths(costs, down, across):
    height, width = costs.shape[:2]
    return width if across == 0 else height if down == 0 else width + height - 1


@parallel(_count_paths)
def _add_paths(path, costs, guide, down, across, sums):
    """Add the costs along all paths of one direction: sums[t, s, n]."""
    height, width, count = costs.shape
    s = path if down != 0 and path < width else 0
    t = path if down == 0 else max(path - width + 1, 0)
    if down < 0:
        t = height - 1 - t
    if across < 0:
        s = width - 1 - s
    way = np.full(count + 2, np.float32(np.inf))
    new = way.copy()
    least, before = np.float32(0.0), guide[t, s]
    way[1:-1] = 0.0
    while 0 <= t < height and 0 <= s < width:
        change = abs(guide[t, s] - before)
        jump = least + max(np.float32(JUMP) / (1 + np.float32(EDGE) * change), np.float32(STEP))
        before = guide[t, s]
        for n in range(np.uint64(count)):
            beside = min(way[n], way[n + np.uint64(2)]) + np.float32(STEP)
            best = min(min(way[n + np.uint64(1)], beside), jump)
            new[n + np.uint64(1)] = costs[t, s, n] + (best - least)
        least = np.float32(np.inf)
        for n in range(np.uint64(count)):
            value = new[n + np.uint64(1)]
            sums[t, s, n] += value
            least = min(least, value)
        way, new = new, way
        t += down
        s += across


@parallel(lambda costs: len(costs))
def _pick(t, costs, sums, place, inside):
    """Step of the search with the least sum, and whether it is neither first nor last."""
    height, width, count = costs.shape
    for s in range(width):
        k = 0
        for n in range(count):
            if sums[t, s, n] < sums[t, s, k]:
                k = n
        place[t, s], inside[t, s] = k, False
        if 0 < k < count - 1:
            before, own, after = costs[t, s, k - 1], costs[t, s, k], costs[t, s, k + 1]
            bend = before + after - 2 * own
            if bend > BENT:
                off = (before - after) / (2 * bend)
                place[t, s] = k + min(max(off, np.float32(-0.5)), np.float32(0.5))
                inside[t, s] = True


@parallel(lambda place: len(place))
def _vote(t, place, inside, guide, near, count, close, voted, confidence):
    """Mean of the votes for the slope with most of them, and the majority of those that agree.

    near[distance]: weights along either axis; close: largest difference of those that agree.
    """
    height, width = place.shape
    reach = near.size - 1
    votes = np.empty(count + 3)
    weights = np.empty(near.size * near.size * 4)
    for s in range(width):
        votes[:] = 0.0
        index = 0
        for y in range(max(t - reach, 0), min(t + reach + 1, height)):
            for x in range(max(s - reach, 0), min(s + reach + 1, width)):
                unlike = (guide[y, x] - guide[t, s]) / ALIKE
                weight = near[abs(y - t)] * near[abs(x - s)] / (1 + unlike * unlike)
                counts = weight if inside[y, x] else MUTE * weight
                k = int(place[y, x])
                part = counts * (place[y, x] - k)
                votes[k + 1] += counts - part
                votes[k + 2] += part
                weights[index] = weight
                index += 1
        best = 1
        most = -1.0
        for k in range(1, count + 1):
            some = votes[k] + 0.5 * (votes[k - 1] + votes[k + 1])
            if some > most:
                best, most = k, some
        counted, weighted, index = 0.0, 0.0, 0
        for y in range(max(t - reach, 0), min(t + reach + 1, height)):
            for x in range(max(s - reach, 0), min(s + reach + 1, width)):
                if abs(place[y, x] - (best - 1)) <= SAME:
                    counts = weights[index] if inside[y, x] else MUTE * weights[index]
                    counted += counts
                    weighted += counts * place[y, x]
                index += 1
        mean = weighted / counted
        agree, total, index = 0.0, 0.0, 0
        for y in range(max(t - reach, 0), min(t + reach + 1, height)):
            for x in range(max(s - reach, 0), min(s + reach + 1, width)):
                total += weights[index]
                if inside[y, x] and abs(place[y, x] - mean) <= close:
                    agree += weights[index]
                index += 1
        voted[t, s], confidence[t, s] = mean, max(2 * agree / total - 1, 0.0)
