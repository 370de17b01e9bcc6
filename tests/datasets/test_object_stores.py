"""Data sets built in an object store, a server on this machine that speaks S3."""

import hashlib

import pytest
from builders import DATA

from lf_flame import InputError
from lf_flame.datasets.config import config_from_json
from lf_flame.datasets.making import make_dataset
from lf_flame.datasets.store import Dataset

s3fs = pytest.importorskip("s3fs")
server = pytest.importorskip("moto.server")
pytestmark = [
    pytest.mark.slow,
    pytest.mark.filterwarnings("ignore::ResourceWarning"),
    pytest.mark.filterwarnings("ignore::DeprecationWarning"),
    pytest.mark.filterwarnings("ignore::FutureWarning"),
]

SAMPLES = 20


@pytest.fixture(scope="module")
def config():
    return config_from_json(DATA, "here")


@pytest.fixture(scope="module")
def store():
    """A server with an empty bucket, and the environment by which clients find it."""
    running = server.ThreadedMotoServer(port=0)
    running.start()
    host, port = running.get_host_and_port()
    with pytest.MonkeyPatch.context() as patch:
        patch.setenv("AWS_ENDPOINT_URL", f"http://{host}:{port}")
        patch.setenv("AWS_ACCESS_KEY_ID", "someone")
        patch.setenv("AWS_SECRET_ACCESS_KEY", "something")
        patch.setenv("AWS_DEFAULT_REGION", "us-east-1")
        files = s3fs.S3FileSystem()
        files.mkdir("flames")
        yield files
    running.stop()


@pytest.fixture(scope="module")
def in_folder(config, tmp_path_factory):
    path = tmp_path_factory.mktemp("folder") / "a.zarr"
    make_dataset(config, SAMPLES, path)
    return path


def hashes(path):
    """SHA-256 of every file of samples, by its place."""
    return {
        str(file.relative_to(path)): hashlib.sha256(file.read_bytes()).hexdigest()
        for file in path.rglob("*")
        if file.is_file() and file.name != "zarr.json"
    }


def copied(store, name, tmp_path):
    """Copy a data set from the store, and compute all its hashes again."""
    store.get(f"flames/{name}", str(tmp_path / name), recursive=True)
    found = Dataset(tmp_path / name)
    assert found.verify() == ["attributes", "images", "parameters"]
    return tmp_path / name


def test_a_store_holds_the_bytes_of_a_folder_though_it_was_cut(config, store, in_folder, tmp_path):
    """And what is there stays: another data set, a finished one, anything else."""

    def cut(finished, _done, _total):
        yield next(iter(finished))
        raise KeyboardInterrupt

    def count(finished, done, _total):
        seen.append(done)
        yield from finished

    seen, url = [], "s3://flames/cut.zarr"
    with pytest.raises(KeyboardInterrupt):
        make_dataset(config, SAMPLES, url, progress=cut)
    with pytest.raises(InputError, match=r"cut\.zarr was begun with another configuration"):
        make_dataset(config, SAMPLES + 1, url)
    make_dataset(config, SAMPLES, url, workers=2, progress=count)
    assert seen == [16]
    assert hashes(copied(store, "cut.zarr", tmp_path)) == hashes(in_folder)
    with pytest.raises(InputError, match=r"s3://flames/cut\.zarr exists"):
        make_dataset(config, SAMPLES, url)
    store.pipe("flames/thesis/chapter.txt", b"years of work")
    with pytest.raises(InputError, match="s3://flames/thesis is in the way"):
        make_dataset(config, SAMPLES, "s3://flames/thesis")
    assert store.find("flames/thesis") == ["flames/thesis/chapter.txt"]


@pytest.mark.parametrize("text", ["[]", '{"attributes": []}', "{"])
def test_damaged_metadata_are_one_sentence(config, store, text):
    store.pipe("flames/damaged/zarr.json", text.encode())
    with pytest.raises(InputError, match=r"flames/damaged"):
        make_dataset(config, 1, "s3://flames/damaged")


@pytest.mark.parametrize(
    ("url", "said"),
    [
        ("s3://no-such-bucket/a.zarr", "s3://no-such-bucket/a.zarr cannot be reached"),
        ("file:///tmp/a.zarr", "give its path"),
        ("nonsense://a/b", "nonsense://a/b cannot be reached"),
    ],
)
def test_what_cannot_be_reached_is_one_sentence(config, store, url, said):
    with pytest.raises(InputError, match=said):
        make_dataset(config, 1, url)
