"""Raw pictures of lenslets by geometry of the tests' own: nothing of the package is used."""

import numpy as np


def nearest_lenslet(y, x, pitch, row_pitch=None, hexagonal=False):
    """Give row, place along the row, and way (down, along) from the lenslet nearest to places.

    The first lenslet stands at the origin, and the place counts pitches from it. All lenslets of
    the two rows beside a place are compared.
    """
    row_pitch = row_pitch or pitch * (np.sqrt(3) / 2 if hexagonal else 1)
    best = np.full((4, *y.shape), np.inf)
    for row in (np.floor(y / row_pitch), np.ceil(y / row_pitch)):
        shifted = row % 2 / 2 if hexagonal else 0
        place = np.round(x / pitch - shifted) + shifted
        found = np.stack([row, place, y - row * row_pitch, x - place * pitch])
        best = np.where(np.hypot(*found[2:]) < np.hypot(*best[2:]), found, best)
    return best


def waves(down, right, amplitude, rng):
    """Sum twenty plane waves 4 to 8 units long."""
    drawn = rng.uniform(4, 8, 20), rng.uniform(0, 6.28, 20), rng.uniform(0, 6.28, 20)
    return amplitude * sum(
        np.cos(2 * np.pi * (np.sin(angle) * down + np.cos(angle) * right) / length + phase)
        for length, angle, phase in zip(*drawn, strict=True)
    )


class Sensor:
    """A sensor under round micro-images that touch, whose middle lenslet stands beside its middle.

    The lenslets stand in rows; if `columns`, all is transposed, so that they stand in columns.
    """

    def __init__(self, shape, pitch, rotation=0.0, hexagonal=True, columns=False, sub=3):
        self.shape, self.pitch, self.rotation = shape, pitch, rotation
        self.hexagonal, self.columns, self.sub = hexagonal, columns, sub
        y, x = (
            (np.arange(n * sub) + 0.5) / sub - n / 2 - a
            for n, a in zip(shape, (0.8, 2.3), strict=True)
        )
        z = (x + 1j * y[:, None]) * np.exp(-1j * rotation)
        found = nearest_lenslet(z.imag, z.real, pitch, hexagonal=hexagonal)
        self.row, self.column, self.down, self.along = found
        self.row = self.row * (np.sqrt(3) / 2 if hexagonal else 1)  # in pitches

    def pixels(self, light):
        rows, columns = self.shape
        light = light.reshape(rows, self.sub, columns, self.sub).mean(axis=(1, 3))
        return light.T if self.columns else light

    def lit(self, falloff=0.25):
        far = (self.down**2 + self.along**2) / (self.pitch / 2) ** 2
        return np.where(far <= 1, 1 - falloff * far, 0.0)

    def plane(self, slope, seed=1, falloff=0.25):
        """Raw image of a plane of waves, which moves by `slope` pitches from pixel to pixel.

        It is 0.5 in the mean; at their rim micro-images are darker by `falloff`.
        """
        y, x = self.row - slope * self.down, self.column - slope * self.along
        light = 0.5 + waves(y, x, 0.03, np.random.default_rng(seed))
        return self.pixels(light * self.lit(falloff))

    def spots(self, breadth, borders=0):
        """Spots of some pixels; dark from `borders` lenslets on, and weak before."""
        spot = np.exp(-4 * np.log(2) * (self.down**2 + self.along**2) / breadth**2)
        far = np.maximum(
            np.abs(self.row) / np.abs(self.row).max(), np.abs(self.column) / self.column.max()
        )
        edge = 1 - borders * self.pitch / min(self.shape)
        return self.pixels(spot * np.where(far < edge, np.where(far > edge - 0.07, 0.15, 1), 0))

    def error(self, grid):
        """Relative errors of pitches, of rotation in rad, and distance in pixels at the middle."""
        y0, x0 = (n / 2 - 0.5 + a for n, a in zip(self.shape, (0.8, 2.3), strict=True))
        grid = grid.upright
        z = (x0 - grid.x0 + 1j * (y0 - grid.y0)) * np.exp(-1j * grid.rotation)
        row, place, down, along = nearest_lenslet(
            np.array([z.imag]), np.array([z.real]), grid.pitch, grid.row_pitch, self.hexagonal
        )
        step = self.pitch * (np.sqrt(3) / 2 if self.hexagonal else 1)
        pitches = max(abs(grid.pitch / self.pitch - 1), abs(grid.row_pitch / step - 1))
        return pitches, abs(grid.rotation - self.rotation), float(np.hypot(down, along)[0])

    def slope(self, slope, views):
        """Slope of the views, in their pixels, which are as far apart as the array's rows."""
        return slope * self.pitch / views * (2 / np.sqrt(3) if self.hexagonal else 1)
