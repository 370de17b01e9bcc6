"""Light fields in files larger than memory: what is read in parts is what is read as a whole."""

import json

import h5py
import numpy as np
import pytest
import zarr

from lf_flame import InputError, LightField
from lf_flame.formats import open_light_field, read_light_field, write_light_field
from lf_flame.formats.images import to_levels, write_image
from lf_flame.formats.view_files.orders import arranged


@pytest.fixture
def views(rng):
    return rng.uniform(size=(3, 4, 50, 30, 3)).astype(np.float32)


def assert_same(path, whole=None, **options):
    """Rows and single views of an opened light field are those of the one that is read."""
    whole = read_light_field(path, **options) if whole is None else whole
    opened = open_light_field(path, **options)
    assert opened.shape == whole.shape
    np.testing.assert_array_equal(opened.rows(7, 19).views, whole.views[:, :, 7:19])
    np.testing.assert_array_equal(opened.view(2, 1), whole.views[2, 1])
    assert opened.brightest_rows.views.max() == whole.views.max()
    return opened


@pytest.mark.parametrize(
    ("axes", "kind"),
    [(None, np.uint8), ("tsvuc", np.float32), ("cvuts", np.uint8), ("vtusc", np.float32)],
)
def test_arrays_in_any_file_and_order_of_axes(views, axes, kind, tmp_path):
    levels = views if kind == np.float32 else to_levels(views, 8)
    stored = levels.transpose(["vutsc".index(letter) for letter in axes or "vutsc"])
    np.save(tmp_path / "a.npy", stored)
    with h5py.File(tmp_path / "a.h5", "w") as file:
        file.create_dataset("scene/a", data=stored, compression="gzip")
    zarr.create_array(str(tmp_path / "a.zarr"), data=stored)
    for name in ("a.npy", "a.h5", "a.zarr"):
        assert_same(tmp_path / name, axes=axes)


def test_a_running_number_and_a_stated_order(views, tmp_path):
    np.save(tmp_path / "n.npy", views.reshape(12, 50, 30, 3))
    for order in (None, "row,-col", "snake,row,col"):
        ours = views if order is None else arranged(views, order)
        options = {"axes": "ntsc", "grid": (3, 4), "order": order}
        assert_same(tmp_path / "n.npy", LightField(ours), **options)
    write_light_field(LightField(views), tmp_path / "v.zarr")
    assert_same(tmp_path / "v.zarr", order="-row,-col")


def test_matlab_stores_axes_in_reverse(views, tmp_path):
    with h5py.File(tmp_path / "a.mat", "w", userblock_size=512) as file:
        file["LF"] = views.T
    with (tmp_path / "a.mat").open("r+b") as file:
        file.write(b"MATLAB 7.3 MAT-file")
    assert_same(tmp_path / "a.mat")


def test_weights_and_missing_views_are_known(views, tmp_path):
    weights = np.linspace(0.1, 1, 12).reshape(3, 4).astype(np.float32)
    write_light_field(LightField(views, weights=weights), tmp_path / "a.zarr")
    np.testing.assert_array_equal(read_light_field(tmp_path / "a.zarr").weights, weights)
    turned = open_light_field(tmp_path / "a.zarr", order="-row,col")
    np.testing.assert_array_equal(turned.weights, weights[::-1])
    assert list(zarr.open(str(tmp_path / "a.zarr"))["views"].metadata.dimension_names) == [
        "v", "u", "t", "s", "channel",
    ]  # fmt: skip
    (tmp_path / "views").mkdir()
    for v, u in np.ndindex(3, 4):
        if (v, u) != (1, 2):
            write_image(tmp_path / "views" / f"{v}_{u}.png", to_levels(views[v, u], 16))
    opened = assert_same(tmp_path / "views", order="row,col")
    assert opened.weights[1, 2] == 0
    assert opened.weights.sum() == 11


def test_the_copy_of_a_folder_is_removed_with_the_light_field(views, tmp_path, monkeypatch):
    (tmp_path / "scratch").mkdir()
    monkeypatch.setattr("tempfile.tempdir", str(tmp_path / "scratch"))
    write_light_field(LightField(views), tmp_path / "views")
    opened = open_light_field(tmp_path / "views").rearranged()
    assert opened.rows(0, 1).shape == (3, 4, 1, 30, 3)
    assert len(list((tmp_path / "scratch").iterdir())) == 1
    del opened
    assert not list((tmp_path / "scratch").iterdir())


@pytest.mark.parametrize("name", ["b.npy", "b.zarr"])
def test_a_light_field_larger_than_memory_is_written_in_bands(views, name, tmp_path, monkeypatch):
    np.save(tmp_path / "a.npy", views)
    opened = open_light_field(tmp_path / "a.npy")
    monkeypatch.setenv("LF_FLAME_MEMORY_GB", repr(8 * 6 * views[:, :, 0].nbytes / 1e9))
    assert len(opened.plan()) > 5
    write_light_field(opened, tmp_path / name)
    monkeypatch.delenv("LF_FLAME_MEMORY_GB")
    np.testing.assert_array_equal(read_light_field(tmp_path / name).views, views)


def test_what_cannot_be_opened_is_refused_in_a_sentence(views, tmp_path, monkeypatch):
    write_light_field(LightField(views), tmp_path / "a.npz")
    with pytest.raises(InputError, match=r"Parts of .*a\.npz cannot be read: store it as"):
        open_light_field(tmp_path / "a.npz")
    write_light_field(LightField(views[..., 0]), tmp_path / "a.png")
    with pytest.raises(InputError, match=r"lf-flame convert SOURCE TARGET\.zarr"):
        open_light_field(tmp_path / "a.png")
    np.save(tmp_path / "a.npy", views)
    opened = open_light_field(tmp_path / "a.npy")
    with pytest.raises(InputError, match=r"written as \.npy or \.zarr"):
        write_light_field(opened, tmp_path / "a.tif")
    (tmp_path / "empty.zarr").mkdir()
    with pytest.raises(InputError, match=r"empty\.zarr"):
        open_light_field(tmp_path / "empty.zarr")
    bad = views.copy()
    bad[1, 1, 9] = np.nan
    np.save(tmp_path / "bad.npy", bad)
    opened = open_light_field(tmp_path / "bad.npy")
    assert opened.rows(0, 9)
    with pytest.raises(InputError, match="finite"):
        opened.rows(9, 10)
    write_light_field(LightField(views), tmp_path / "views")
    monkeypatch.setattr("shutil.disk_usage", lambda _: type("Usage", (), {"free": 1000}))
    with pytest.raises(InputError, match=r"GB of temporary files .* TMPDIR sets another folder"):
        open_light_field(tmp_path / "views")


def test_a_zarr_folder_without_one_of_its_chunks_is_refused(views, tmp_path):
    """Also chunks of zeros are written, as a missing one would be read as zeros."""
    write_light_field(LightField(0 * views), tmp_path / "a.zarr")
    assert read_light_field(tmp_path / "a.zarr").shape == views.shape
    next(file for file in (tmp_path / "a.zarr/views/c").rglob("*") if file.is_file()).unlink()
    for read in (read_light_field, open_light_field):
        with pytest.raises(InputError, match=r"read: 1 of its \d+ chunk files are missing"):
            read(tmp_path / "a.zarr")


def test_damaged_and_dangerous_zarr_folders_are_refused(views, tmp_path):
    write_light_field(LightField(views), tmp_path / "a.zarr")
    for chunk in (tmp_path / "a.zarr/views/c").rglob("*"):
        if chunk.is_file():
            chunk.write_bytes(b"no chunk")
    with pytest.raises(InputError, match="cannot be read"):
        read_light_field(tmp_path / "a.zarr")
    with pytest.raises(InputError, match="cannot be read"):
        open_light_field(tmp_path / "a.zarr").rows(0, 2)
    path = tmp_path / "b.zarr"
    zarr.create_array(str(path), shape=views.shape, dtype="f4", zarr_format=2)
    record = json.loads((path / ".zarray").read_text())
    (path / ".zarray").write_text(json.dumps({**record, "compressor": {"id": "pickle"}}))
    with pytest.raises(InputError, match="pickle"):
        read_light_field(tmp_path / "b.zarr")
