"""Images, lenslet images, arrays and stacks: round trips and what is refused."""

import json
import re

import h5py
import numpy as np
import pytest
import tifffile
from hypothesis import given, settings
from hypothesis import strategies as st

from lf_flame import InputError, LightField
from lf_flame.formats import (
    read_focal_stack,
    read_light_field,
    write_focal_stack,
    write_light_field,
)
from lf_flame.formats.images import write_image

SEEDS = st.integers(0, 2**32)


def levels(rng, shape, bits=8):
    return rng.integers(0, 2**bits, shape, f"uint{bits}")


LENSLETS = st.tuples(*[st.integers(1, 5)] * 4, st.sampled_from([0, 3]))


@settings(max_examples=25, deadline=None)
@given(LENSLETS, st.sampled_from([8, 16]), st.sampled_from([".png", ".tiff"]), SEEDS)
def test_a_lenslet_image_comes_back(tmp_path_factory, shape, bits, suffix, seed):
    n, _, t, s, channels = shape
    full = (n, n, t, s, channels) if channels else (n, n, t, s)
    views = levels(np.random.default_rng(seed), full, bits) / np.float32(2**bits - 1)
    path = tmp_path_factory.mktemp("lenslets") / f"raw{suffix}"
    write_light_field(LightField(views), path, bits)
    np.testing.assert_array_equal(read_light_field(path, views=n).views, views)
    turned = read_light_field(path, order="row,-col", views=n).views
    np.testing.assert_array_equal(turned, views[:, ::-1])


def test_a_lenslet_image_lies_as_eslf_files_do(tmp_path, rng):
    raw = levels(rng, (28, 42, 3), bits=16)
    write_image(tmp_path / "flowers_eslf.png", raw)
    views = read_light_field(tmp_path / "flowers_eslf.png", views=14).views
    assert views.shape == (14, 14, 2, 3, 3)
    np.testing.assert_array_equal(views[5, 9], raw[5::14, 9::14] / np.float32(65535))


@pytest.mark.parametrize(
    ("dtype", "shape"),
    [
        *((name, (2, 3, 4, 5)) for name in ("f2", ">f4", "u2")),
        *((name, (2, 2, 3, 4, 3)) for name in ("f4", "f8", "u1")),
    ],
)
def test_arrays_come_back(tmp_path, rng, dtype, shape):
    array = (rng.uniform(size=shape) * (200 if "u" in dtype else 1)).astype(dtype)
    top = {"u1": 255, "u2": 65535}.get(dtype, 1)
    np.save(tmp_path / "a.npy", array)
    np.savez(tmp_path / "b.npz", field=array)
    np.savez_compressed(tmp_path / "c.npz", depth=array[0, 0], views=array, more=array)
    for name in ("a.npy", "b.npz", "c.npz"):
        views = read_light_field(tmp_path / name).views
        assert views.dtype == np.float32
        np.testing.assert_array_equal(views, (array / np.float32(top)).astype(np.float32))


def test_raw_arrays_are_cut(tmp_path, rng):
    views = rng.uniform(size=(3, 3, 4, 5, 3)).astype(np.float32)
    np.save(tmp_path / "a.npy", LightField(views).to_raw())
    np.savez(tmp_path / "b.npz", raw=LightField(views[..., 0]).to_raw())
    np.testing.assert_array_equal(read_light_field(tmp_path / "a.npy", views=3).views, views)
    np.testing.assert_array_equal(
        read_light_field(tmp_path / "b.npz", views=3).views, views[..., 0]
    )
    with pytest.raises(InputError, match=r"state the number of pixels under a lenslet .*\(3\)"):
        read_light_field(tmp_path / "b.npz")


@pytest.mark.parametrize(
    ("name", "axes", "shape"),
    [
        ("a.npy", "ntsc", (81, 80, 64, 3)),
        ("a.npy", "tsvu", (80, 64, 9, 9)),
        ("a.npy", "cnts", (3, 81, 80, 64)),
        ("a.npy", "vtus", (9, 80, 9, 64)),
        ("a.npy", "tsn", (96, 128, 35)),
        ("a.h5", "cstuv", (3, 128, 96, 7, 5)),  # as MATLAB writes it, backwards
        ("a.h5", "stuv", (128, 96, 7, 5)),
    ],
)
def test_arrays_in_another_order_are_refused_with_axes_that_read_them(
    tmp_path, rng, name, axes, shape
):
    path, array = tmp_path / name, rng.integers(0, 256, shape, np.uint8)
    if name.endswith(".h5"):
        with h5py.File(path, "w") as file:
            file["LF"] = array
    else:
        np.save(path, array)
    with pytest.raises(InputError, match=rf"{re.escape(str(shape))}, which is unlikely to be"):
        read_light_field(path, views=1)
    wanted = "n" if "n" in axes else "vu" if "v" in axes else ""
    wanted += "tsc" if "c" in axes else "ts"
    grid = {81: (9, 9), 35: (5, 7)}[shape[axes.index("n")]] if "n" in axes else None
    views = read_light_field(path, axes=axes, grid=grid, views=None if "vu" in wanted else 1).views
    expected = np.einsum(f"{axes}->{wanted}", array).reshape(views.shape)
    np.testing.assert_array_equal(views, expected / np.float32(255))


def test_files_of_this_package_are_read_whatever_their_shape(tmp_path, rng):
    """More views than pixels, and a spectrum of channels."""
    for shape in ((9, 9, 5, 6), (5, 5, 20, 24, 8)):
        array = rng.uniform(size=shape).astype(np.float32)
        write_light_field(LightField(array), tmp_path / "a.npz")
        np.testing.assert_array_equal(read_light_field(tmp_path / "a.npz").views, array)


@pytest.mark.parametrize(("bits", "channels"), [(8, ()), (32, ()), (16, (3,)), (32, (3,))])
def test_pages_are_read_as_views(tmp_path, rng, bits, channels):
    views = rng.uniform(size=(3, 3, 10, 12, *channels)).astype(np.float32)
    kept, top = views, 1
    if bits < 32:
        kept, top = levels(rng, views.shape, bits), 2**bits - 1
    photometric = "rgb" if channels else "minisblack"
    row = kept.reshape(9, *kept.shape[2:])
    tifffile.imwrite(tmp_path / "row.tif", row, photometric=photometric)
    tifffile.imwrite(tmp_path / "grid.tiff", kept, photometric=photometric, compression="zlib")
    with tifffile.TiffWriter(tmp_path / "pages.tif") as file:
        for page in row:
            file.write(page, photometric=photometric, contiguous=False)
    if not (channels and bits > 8):
        axes = "ZYXS" if channels else "ZYX"
        tifffile.imwrite(tmp_path / "imagej.tif", row, imagej=True, metadata={"axes": axes})
    for path in tmp_path.iterdir():
        stated = {} if path.name == "grid.tiff" else {"grid": "3x3"}
        back = read_light_field(path, **stated).views
        np.testing.assert_array_equal(back, kept / np.float32(top), err_msg=path.name)
        turned = read_light_field(path, order="col,row", **stated).views
        np.testing.assert_array_equal(turned, back.swapaxes(0, 1))


def test_two_axes_of_pages_are_rows_and_columns(tmp_path, rng):
    """Thirty-six pages would be a square, too."""
    pages = levels(rng, (4, 9, 10, 12))
    tifffile.imwrite(tmp_path / "a.tif", pages, photometric="minisblack")
    np.testing.assert_array_equal(
        read_light_field(tmp_path / "a.tif").views, pages / np.float32(255)
    )


def test_colours_in_planes_of_their_own_are_no_views(tmp_path, rng):
    pages = levels(rng, (9, 3, 10, 12), bits=16)
    tifffile.imwrite(tmp_path / "a.tif", pages, imagej=True, metadata={"axes": "ZCYX"})
    views = read_light_field(tmp_path / "a.tif", grid=(3, 3)).views
    expected = np.moveaxis(pages, 1, -1).reshape(3, 3, 10, 12, 3) / np.float32(65535)
    np.testing.assert_array_equal(views, expected)


@settings(max_examples=25, deadline=None)
@given(
    st.integers(1, 5),
    st.tuples(st.integers(2, 6), st.integers(2, 6)),
    st.sampled_from([(), (1,), (2,), (3,), (4,)]),
    st.floats(-10, 10),
    SEEDS,
)
def test_a_focal_stack_comes_back_with_its_slopes(tmp_path_factory, n, shape, channels, step, seed):
    stack = np.random.default_rng(seed).normal(size=(n, *shape, *channels)).astype(np.float32)
    slopes = step * np.arange(n)
    path = tmp_path_factory.mktemp("stack") / "stack.tif"
    write_focal_stack(stack, slopes, path)
    back, kept = read_focal_stack(path)
    np.testing.assert_array_equal(back, stack[..., 0] if channels == (1,) else stack)
    np.testing.assert_array_equal(kept, slopes)


def test_imagej_sees_the_planes_and_their_slopes(tmp_path, rng):
    write_focal_stack(rng.uniform(size=(3, 4, 5, 3)), [-1.25, 0, 2.1], tmp_path / "stack.tif")
    with tifffile.TiffFile(tmp_path / "stack.tif") as file:
        assert file.is_imagej
        assert len(file.pages) == 9
        assert file.pages[0].dtype == np.float32
        told = file.imagej_metadata
    assert (told["slices"], told["channels"]) == (3, 3)
    assert json.loads(told["slopes"]) == [-1.25, 0, 2.1]
    assert told["Labels"][::3] == ["slope -1.25", "slope 0", "slope 2.1"]


def test_focal_stacks_of_other_programs_have_no_slopes(tmp_path, rng):
    stack = levels(rng, (4, 5, 6), bits=16)
    tifffile.imwrite(tmp_path / "a.tif", stack, photometric="minisblack")
    back, slopes = read_focal_stack(tmp_path / "a.tif")
    assert slopes is None
    np.testing.assert_array_equal(back, stack / np.float32(65535))
