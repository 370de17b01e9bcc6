"""The compiled loops of focused lenslets: matching of micro-images, and views."""

import numpy as np
from numba import njit

from lf_flame._common.threads import parallel


@njit
def between(image, y, x, channel):
    """Value between the pixels of an image by linear interpolation; edges are continued."""
    y = min(max(y, 0.0), image.shape[0] - 1.001)
    x = min(max(x, 0.0), image.shape[1] - 1.001)
    row, column = int(y), int(x)
    down, right = y - row, x - column
    upper = (1 - right) * image[row, column, channel] + right * image[row, column + 1, channel]
    row += 1
    lower = (1 - right) * image[row, column, channel] + right * image[row, column + 1, channel]
    return (1 - down) * upper + down * lower


@njit
def compare(own, image, y, x, spots, down, right, radius):
    """Covariance of a micro-image and another, centred at (y, x), and root of their variances.

    own: the micro-image at the points `spots`, from its centre. The other is compared at the same
    points less (down, right), where these are within the radius; 0 and 0 if fewer than 12 are.
    """
    count, a, b, aa, bb, ab = 0, 0.0, 0.0, 0.0, 0.0, 0.0
    for n in range(len(spots)):
        at_y, at_x = spots[n, 0] - down, spots[n, 1] - right
        if at_y * at_y + at_x * at_x > radius * radius:
            continue
        other = between(image, y + at_y, x + at_x, 0)
        count += 1
        a += own[n]
        b += other
        aa += own[n] * own[n]
        bb += other * other
        ab += own[n] * other
    if count < 12:
        return 0.0, 0.0
    here, there = aa - a * a / count, bb - b * b / count
    return ab - a * b / count, np.sqrt(max(here, 0.0) * max(there, 0.0))


@parallel(lambda kinds: kinds.size)
def match(i, image, centres, kinds, near, spots, radius, start, steps, similarity):
    """Similarity of each micro-image to its neighbours', displaced as at inverse virtual depths.

    It is the covariance of both over the geometric mean of their variances, each summed over the
    neighbours: 1 where they are equal except for mean and contrast, about 0 where there is only
    noise. Neighbours of the same kind have more weight, because their blur is the same.

    image: shape (rows, columns, 1). centres: (n, 2). kinds: (n,). near: (n, k), the neighbours'
    numbers, and n after the last. spots: (m, 2), points in a micro-image, from its centre. start:
    (n,) and steps: inverse depths, which are added. similarity: (n, steps), filled.
    """
    y, x = centres[i, 0], centres[i, 1]
    own = np.empty(len(spots))
    for n in range(len(spots)):
        own[n] = between(image, y + spots[n, 0], x + spots[n, 1], 0)
    for k in range(len(steps)):
        inverse = start[i] + steps[k]
        common, total = 0.0, 0.0
        for j in near[i]:
            if j == kinds.size:
                break
            its_y, its_x = centres[j, 0], centres[j, 1]
            down, right = inverse * (its_y - y), inverse * (its_x - x)
            # Weights fall to 0 with the part that both see, so that the similarity has no steps
            # where neighbours come into reach.
            weight = 1 - (down * down + right * right) / (1.6 * radius) ** 2
            if weight <= 0:
                continue
            if kinds[j] != kinds[i]:  # at small depths, only these see the same
                weight *= 0.03
            both, spread = compare(own, image, its_y, its_x, spots, down, right, radius)
            common += weight * both
            total += weight * spread
        similarity[i, k] = common / total if total > 0 else 0.0


@parallel(lambda views: views.shape[0] * views.shape[1])
def render(
    piece, image, centres, inverse, weights, near, cell, offsets, view, reach, radius, views
):  # fmt: skip
    """Assemble views from patches of the micro-images.

    A point of a view belongs to the lenslets near it. Each gives the part of its micro-image around
    the view's offset, magnified by the lenslet's virtual depth; nearer ones have more weight.

    image: shape (rows, columns, channels). centres: (n, 2), with inverse virtual depths and weights
    of the lenslets. near: (down, along, k), numbers of those within reach of each square of a
    picture, `cell` pixels wide, and n after the last. offsets: points of the views in a
    micro-image, from its centre. view: first y, first x, pixels per pixel of a view, and virtual
    depth at which views coincide. reach, radius: of lenslets, and in a micro-image, in pixels.
    views: (offsets, t, s, channels), filled.
    """
    top, left, step, reference = view
    n, t = piece // views.shape[1], piece % views.shape[1]
    sums = np.empty(image.shape[2])
    for s in range(views.shape[2]):
        y = top + step * t - reference * offsets[n, 0]
        x = left + step * s - reference * offsets[n, 1]
        total = 0.0
        sums[:] = 0.0
        for j in near[int(y / cell), int(x / cell)]:
            if j == len(centres):
                break
            down, right = y - centres[j, 0], x - centres[j, 1]
            distance = np.sqrt(down * down + right * right)
            if distance >= reach:
                continue
            weight = weights[j] * (1 - distance / reach) ** 2
            at_y, at_x = offsets[n, 0] + down * inverse[j], offsets[n, 1] + right * inverse[j]
            away = np.sqrt(at_y * at_y + at_x * at_x)
            if away > radius:  # the lenslet does not see the point, and is used if none does
                at_y, at_x = at_y * radius / away, at_x * radius / away
                weight *= 1e-6
            total += weight
            for channel in range(image.shape[2]):
                light = between(image, centres[j, 0] + at_y, centres[j, 1] + at_x, channel)
                sums[channel] += weight * light
        for channel in range(image.shape[2]):
            views[n, t, s, channel] = sums[channel] / total if total > 0 else 0.0
