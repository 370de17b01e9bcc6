"""Data sets built in an object store, a server on this machine that speaks S3."""

import hashlib
import json

import pytest
from click.testing import CliRunner
from tiny_data import DATA

from lf_flame import InputError
from lf_flame.commands.cli import commands
from lf_flame.datasets.clusters import cluster_executor
from lf_flame.datasets.config import config_from_json
from lf_flame.datasets.making import make_dataset
from lf_flame.datasets.places import find_place
from lf_flame.datasets.store import Dataset

s3fs = pytest.importorskip("s3fs")
server = pytest.importorskip("moto.server")
pytestmark = [
    pytest.mark.slow,
    pytest.mark.filterwarnings("ignore::ResourceWarning"),
    pytest.mark.filterwarnings("ignore::DeprecationWarning"),
    pytest.mark.filterwarnings("ignore::FutureWarning"),
]

SAMPLES = 40


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


@pytest.mark.parametrize("workers", [1, 2])
def test_a_store_holds_the_bytes_of_a_folder(config, store, in_folder, tmp_path, workers):
    name = f"by-{workers}.zarr"
    make_dataset(config, SAMPLES, f"s3://flames/{name}", workers)
    assert hashes(copied(store, name, tmp_path)) == hashes(in_folder)


def test_a_cluster_builds_in_a_store(config, store, in_folder, tmp_path):
    with cluster_executor(local=2) as executor:
        make_dataset(config, SAMPLES, "s3://flames/cluster.zarr", executor=executor)
    assert hashes(copied(store, "cluster.zarr", tmp_path)) == hashes(in_folder)


def test_a_run_that_was_cut_goes_on(config, store, in_folder, tmp_path):
    def cut(finished, _done, _total):
        yield next(iter(finished))
        raise KeyboardInterrupt

    def count(finished, done, _total):
        seen.append(done)
        yield from finished

    seen = []
    with pytest.raises(KeyboardInterrupt):
        make_dataset(config, SAMPLES, "s3://flames/cut.zarr", progress=cut)
    with pytest.raises(InputError, match=r"cut\.zarr was begun with another configuration"):
        make_dataset(config, SAMPLES + 1, "s3://flames/cut.zarr")
    make_dataset(config, SAMPLES, "s3://flames/cut.zarr", progress=count)
    assert seen == [16]
    assert hashes(copied(store, "cut.zarr", tmp_path)) == hashes(in_folder)


def test_what_is_there_stays(config, store):
    store.pipe("flames/thesis/chapter.txt", b"years of work")
    with pytest.raises(InputError, match="s3://flames/thesis is in the way"):
        make_dataset(config, SAMPLES, "s3://flames/thesis")
    assert store.cat("flames/thesis/chapter.txt") == b"years of work"
    assert store.find("flames/thesis") == ["flames/thesis/chapter.txt"]
    make_dataset(config, 1, "s3://flames/one.zarr")
    with pytest.raises(InputError, match=r"s3://flames/one\.zarr exists"):
        make_dataset(config, 1, "s3://flames/one.zarr")


def test_a_changed_attribute_is_noticed_before_work_goes_on(config, store):
    def cut(finished, _done, _total):
        yield next(iter(finished))
        raise KeyboardInterrupt

    with pytest.raises(KeyboardInterrupt):
        make_dataset(config, SAMPLES, "s3://flames/changed.zarr", progress=cut)
    file = "flames/changed.zarr/zarr.json"
    text = store.cat(file).decode()
    store.pipe(file, text.replace('"depths_mm": [', '"depths_mm": [1.5, ', 1).encode())
    with pytest.raises(InputError, match="attributes"):
        make_dataset(config, SAMPLES, "s3://flames/changed.zarr")


@pytest.mark.parametrize("text", ["[]", '{"more": 1}', '{"attributes": []}', "{", '{"zarr": 5}'])
def test_damaged_metadata_are_one_sentence(config, store, text):
    store.pipe("flames/damaged/zarr.json", text.encode())
    with pytest.raises(InputError, match=r"flames/damaged"):
        make_dataset(config, 1, "s3://flames/damaged")
    store.rm("flames/damaged", recursive=True)


def test_what_is_no_fault_of_the_store_is_not_laid_to_it(config, store):
    def killed(_finished, _done, _total):
        raise ChildProcessError("A worker process was killed")

    def mistaken(_finished, _done, _total):
        raise ValueError("ours")

    for number, (fault, kind) in enumerate([(killed, ChildProcessError), (mistaken, ValueError)]):
        with pytest.raises(kind):
            make_dataset(config, 1, f"s3://flames/fault-{number}.zarr", progress=fault)


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


def test_no_server_is_one_sentence(config, store, monkeypatch):
    monkeypatch.setenv("AWS_ENDPOINT_URL", "http://127.0.0.1:9")
    s3fs.S3FileSystem.clear_instance_cache()
    with pytest.raises(InputError, match="cannot be reached"):
        find_place("s3://flames/b.zarr").attributes()
    s3fs.S3FileSystem.clear_instance_cache()


def test_the_command_takes_a_url(store, in_folder, tmp_path):
    template = DATA["template"]
    sections = [
        ("", {key: DATA[key] for key in ("kind", "seed", "image")} | {"samples.tiny": SAMPLES}),
        ("[camera]", DATA["camera"]),
        (
            "[template]",
            {key: DATA["template"][key] for key in DATA["template"] if key != "objects"},
        ),
        ("[[template.objects]]", template["objects"][0]),
    ]
    lines = [
        line
        for header, values in sections
        for line in (header, *(f"{key} = {json.dumps(value)}" for key, value in values.items()))
    ]
    (tmp_path / "tiny.toml").write_text("\n".join(lines))
    arguments = [str(tmp_path / "tiny.toml"), "--preset", "tiny", "--out", "s3://flames/c.zarr"]
    done = CliRunner().invoke(commands, ["dataset", *arguments, "--workers", "1"])
    assert done.exit_code == 0, done.output
    assert hashes(copied(store, "c.zarr", tmp_path)) == hashes(in_folder)
