"""The compiled loops of focused lenslets: matching of micro-images, and views."""

import numpy as np
from numba import njit

from lf_flame._common.threads import parallel

FARTHEST, FEWEST = 1.6, 12
"""Largest displacement, in radii, of micro-images that are compared; fewest places in both."""

OTHER_KIND = 0.03
"""Weight of neighbours of another kind; the only ones that see the same at small depths."""

FAR = 1e-6
"""Weight of a lenslet that does not see a place, in case none does."""


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

    own: the micro-image at the places `spots`, from its centre. The other is compared at the same
    places less (down, right), where these are within the radius; 0 and 0 if too few are.
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
    if count < FEWEST:
        return 0.0, 0.0
    here, there = aa - a * a / count, bb - b * b / count
    return ab - a * b / count, np.sqrt(max(here, 0.0) * max(there, 0.0))


@parallel(lambda whole: whole.size)
def match(
    piece, image, centres, whole, kinds, odd, around, spots, radius, start, steps, likeness
):  # fmt: skip
    """Likeness of each micro-image to its neighbours', displaced as at inverse virtual depths.

    It is the covariance of both over the geometric mean of their variances, each summed over the
    neighbours: 1 where they are equal but for their means and contrasts, about 0 where nothing but
    noise is seen. Neighbours of the same kind count more, because their blur is the same.

    image: shape (rows, columns, 1). centres: (i, j, 2). whole, kinds: (i, j). odd: (i,), whether a
    row of the array is odd. around: (2, n, 2), steps in row and column to the neighbours of
    lenslets in even and in odd rows. spots: (m, 2), places in a micro-image, from its centre.
    start: (i, j) and steps: (k,), inverse depths, which are added. likeness: (i, j, k), filled.
    """
    rows, columns = whole.shape
    i, j = piece // columns, piece % columns
    if not whole[i, j]:
        return
    y, x = centres[i, j, 0], centres[i, j, 1]
    own = np.empty(len(spots))
    for n in range(len(spots)):
        own[n] = between(image, y + spots[n, 0], x + spots[n, 1], 0)
    for k in range(len(steps)):
        inverse = start[i, j] + steps[k]
        common, total = 0.0, 0.0
        for neighbour in range(around.shape[1]):
            row = i + around[odd[i], neighbour, 0]
            column = j + around[odd[i], neighbour, 1]
            if not (0 <= row < rows and 0 <= column < columns and whole[row, column]):
                continue
            its_y, its_x = centres[row, column, 0], centres[row, column, 1]
            down, right = inverse * (its_y - y), inverse * (its_x - x)
            # Weights fall to 0 with the part that both see, so that the likeness has no steps
            # where neighbours begin to count.
            weight = 1 - (down * down + right * right) / (FARTHEST * radius) ** 2
            if weight <= 0:
                continue
            if kinds[row, column] != kinds[i, j]:
                weight *= OTHER_KIND
            both, spread = compare(own, image, its_y, its_x, spots, down, right, radius)
            common += weight * both
            total += weight * spread
        likeness[i, j, k] = common / total if total > 0 else 0.0


@parallel(lambda views: views.shape[0] * views.shape[1])
def render(piece, image, lattice, first, inverse, weights, offsets, view, reach, radius, views):
    """Put views together from patches of the micro-images.

    A place of a view belongs to the lenslets near it. Each gives the part of its micro-image around
    the view's offset, magnified by the lenslet's virtual depth; nearer ones count more.

    image: shape (rows, columns, channels). lattice: y0, x0, pitch, row_pitch, offset of odd rows in
    pitches, cosine and sine of the rotation. first: row and column of the array's first lenslet.
    inverse, weights: (i, j), inverse virtual depths, and weights. offsets: (n, 2), places of the
    views in a micro-image, from its centre. view: first y, first x, pixels per pixel of a view, and
    virtual depth at which views coincide. reach, radius: of lenslets, and in a micro-image, in
    pixels. views: (n, t, s, channels), filled.
    """
    top, left, step, reference = view
    y0, x0, pitch, row_pitch, odd, cos, sin = lattice
    height = views.shape[1]
    n, t = piece // height, piece % height
    sums = np.empty(image.shape[2])
    for s in range(views.shape[2]):
        y = top + step * t - reference * offsets[n, 0] - y0
        x = left + step * s - reference * offsets[n, 1] - x0
        down, along = cos * y - sin * x, sin * y + cos * x
        total = 0.0
        sums[:] = 0.0
        middle = int(np.floor(down / row_pitch + 0.5))
        for row in range(middle - 2, middle + 3):
            across = down - row_pitch * row
            i = row - first[0]
            if not 0 <= i < inverse.shape[0]:
                continue
            place = along / pitch - odd * (row % 2)
            nearest = int(np.floor(place + 0.5))
            for column in range(nearest - 2, nearest + 3):
                aside = pitch * (place - column)
                distance = np.sqrt(across * across + aside * aside)
                j = column - first[1]
                if distance >= reach or not 0 <= j < inverse.shape[1]:
                    continue
                weight = weights[i, j] * (1 - distance / reach) ** 2
                to_y = sin * aside + cos * across
                to_x = cos * aside - sin * across
                at_y = offsets[n, 0] + to_y * inverse[i, j]
                at_x = offsets[n, 1] + to_x * inverse[i, j]
                away = np.sqrt(at_y * at_y + at_x * at_x)
                if away > radius:
                    at_y, at_x = at_y * radius / away, at_x * radius / away
                    weight *= FAR
                # The micro-image's centre is the place less the way from it.
                at_y, at_x = at_y + y0 + y - to_y, at_x + x0 + x - to_x
                total += weight
                for channel in range(image.shape[2]):
                    sums[channel] += weight * between(image, at_y, at_x, channel)
        for channel in range(image.shape[2]):
            views[n, t, s, channel] = sums[channel] / total if total > 0 else 0.0
