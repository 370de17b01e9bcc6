"""Small cameras, scenes and data sets that the tests of several files build."""

import json

import numpy as np
import tifffile
from scipy.ndimage import gaussian_filter, shift

from experiments.emission.truth import Sheet, record
from lf_flame import PlenopticCamera

OPTICS = {
    "main_lens_focal_mm": 150.0,
    "focus_distance_mm": 326.0,
    "lenslet_focal_mm": 0.4,
    "lenslet_pitch_mm": 0.112,
}
"""The paper's optics."""


def camera(views, lenslets, coarser=1):
    """Values of a camera: the paper's optics, its lenslets so many times as wide and as long."""
    wider = {name: round(OPTICS[name] * coarser, 3) for name in OPTICS if "lenslet" in name}
    return {**OPTICS, **wider, "views": views, "lenslets": list(lenslets)}


def camera_toml(views, lenslets):
    """Text of a file with a [camera] table."""
    lines = (f"{name} = {value}" for name, value in camera(views, lenslets).items())
    return "\n".join(["", "[camera]", *lines, ""])


def scene_toml(views, lenslets, shape="circle", depth_mm=5.0, side_mm=1.5):
    """Text of a scene file with one layer."""
    layer = f'shape = "{shape}"\ndepth_mm = {depth_mm}\nsize_mm = [{side_mm}, {side_mm}]\n'
    return f"{camera_toml(views, lenslets)}[[layers]]\n{layer}"


def record_ball(lens, depth, across, width):
    """Views of a glow of a Gaussian width in all directions, as sheets 0.1 mm apart."""
    offsets = np.arange(-round(30 * width), round(30 * width) + 1) / 10
    peaks = np.exp(-((offsets / width) ** 2))
    peaks = peaks / peaks.sum()
    pairs = zip(depth + offsets, peaks, strict=True)
    return record(lens, [Sheet(z, (0.0, across), (width, width), peak) for z, peak in pairs])


def camera_of(lens):
    """Camera of the package with the numbers of a lens of `experiments.emission.truth`."""
    return PlenopticCamera(**lens.numbers())


def toml(values):
    """Text of a TOML file with these values, tables in one line each."""

    def written(value):
        if isinstance(value, dict):
            return f"{{ {', '.join(f'{name} = {written(x)}' for name, x in value.items())} }}"
        if isinstance(value, list):
            return f"[{', '.join(map(written, value))}]"
        return json.dumps(value)

    return "\n".join(f"{name} = {written(value)}" for name, value in values.items())


def shapes(samples, image=(40, 64), views=5, coarser=6, sides_mm=(10.0, 9.0), off_axis_mm=10.0):
    """Values of a data set made directly: a square before the focal plane, a circle behind it."""
    sign = {"square": 1, "circle": -1}
    return {
        "kind": "shapes",
        "seed": 5,
        "image": list(image),
        "route": "direct",
        "samples": {"smoke": samples},
        "camera": camera(views, (6 * side // coarser for side in image), coarser),
        "template": {
            "position_mm": 1.0,
            "size": 0.1,
            "brightness": [0.8, 1.0],
            "objects": [
                {"shape": shape, "depth_mm": 10.0 * sign[shape], "size_mm": [side, side],
                 "centre_mm": [0.0, -off_axis_mm * sign[shape]]}
                for shape, side in zip(sign, sides_mm, strict=False)
            ],
        },
    }  # fmt: skip


DATA = shapes(2, (10, 16), 3, sides_mm=(4.0,), off_axis_mm=0)
"""Values of a data set of one square that is made in a moment."""

RUN = {
    "title": "Test", "preset": "smoke", "seed": 1, "epochs": 2, "best_epoch": 1,
    "recipe": {"batch_size": 2},
    "train_s": 3.5, "machine": "a machine", "backbone_weights": "random", "model": {},
    "split": [0.5, 0.25, 0.25], "parts": {"train": 6, "validation": 3, "test": 3},
    "test_indices": [1, 4, 7], "data": "../a.zarr",
    "dataset": {
        "config": shapes(12, views=3, sides_mm=(9.0, 9.0)),
        "slopes": [1.0, -1.0], "objects": ["square", "circle"],
    },
}  # fmt: skip
"""Record of a training run on two shapes."""


RESPONSES = (
    "wavelength_nm,blue,red\n478,0,0\n479,0,0\n480,1,0\n481,0,0\n639,0,0\n640,0,1\n641,0,0\n"
)
"""Table of two narrow filters: triangles of 2 nm, whose area is 1 nm."""


def write_folder(folder, record, files):
    """Write a folder of emission: its record, and files of bytes or arrays; None is no file."""
    folder.mkdir()
    (folder / "emission.json").write_text(json.dumps(record))
    for name, content in files.items():
        if isinstance(content, bytes):
            (folder / name).write_bytes(content)
        elif content is not None:
            tifffile.imwrite(folder / name, content)
    return folder


def write_section(folder, emission, sigma=None, **facts):
    """Write a folder as ``lf-flame abel`` does."""
    record = {
        "geometry": "section", "axis_mm": 0.25, "axis_depth_mm": -3.0, "radius_mm": 4.0,
        "burner_mm": -12.5, "step_mm": 0.5, "notes": [],
    }  # fmt: skip
    files = {"emission.tif": np.float32(emission)}
    files["sigma.tif"] = None if sigma is None else np.float32(sigma)
    return write_folder(folder, record | facts, files)


def textured(rng, slope=0.7, views=(4, 5), shape=(60, 72)):
    """Draw a plane of blurred noise that is sharp at a slope: views[v, u, t, s] from 0 to 1."""
    texture = gaussian_filter(rng.normal(size=[n + 40 for n in shape]), 2)
    texture = (texture - texture.min()) / np.ptp(texture)
    rows, columns = (slope * (np.arange(n) - (n - 1) / 2) for n in views)
    moved = [[shift(texture, (row, column), order=3) for column in columns] for row in rows]
    return np.array(moved)[:, :, 20:-20, 20:-20].clip(0, 1).astype(np.float32)
