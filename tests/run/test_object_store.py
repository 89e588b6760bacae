"""A collection on an object store: a real S3 server in this process, on the loopback."""

from __future__ import annotations

import json
import subprocess
import sys
from pathlib import Path

import pytest
from fake_chain import FAKE, write_capture

from lfflow.collection import open_collection
from lfflow.collection.leases import run_lease
from lfflow.collection.storage import open_storage
from lfflow.collection.validate import validate
from lfflow.errors import CollectionError
from lfflow.run import Options, run_collection
from lfflow.run.executors import Workers
from lfflow.simulate import simulate_collection

SECRET = "a-secret-that-is-never-stored"  # noqa: S105 - of a server in this process


pytestmark = pytest.mark.heavy


@pytest.fixture(scope="module")
def server():
    """Address and keys come from the environment, as everywhere with S3."""
    moto = pytest.importorskip("moto.server", reason="needs moto[server]")
    pytest.importorskip("s3fs", reason="needs s3fs")
    server = moto.ThreadedMotoServer(ip_address="127.0.0.1", port=0, verbose=False)
    server.start()
    host, port = server.get_host_and_port()
    with pytest.MonkeyPatch.context() as environment:
        for name, value in {"AWS_ENDPOINT_URL": f"http://{host}:{port}", "AWS_ACCESS_KEY_ID": "somebody",
                            "AWS_SECRET_ACCESS_KEY": SECRET, "AWS_DEFAULT_REGION": "us-east-1",
                            "AWS_EC2_METADATA_DISABLED": "true"}.items():  # fmt: skip
            environment.setenv(name, value)
        yield server
    server.stop()


@pytest.fixture
def bucket(server, request):
    """URL of a collection in an empty bucket."""
    import s3fs

    name = f"lab{abs(hash(request.node.name)) % 10**6}"
    s3fs.S3FileSystem().mkdir(name)
    return f"s3://{name}/collection"


@pytest.fixture
def pair(tmp_path):
    """A white image and a scene."""
    write_capture(tmp_path / "two" / "WHITE.lfp", seed=1, kind="white")
    write_capture(tmp_path / "two" / "IMG.lfp", seed=2)
    return tmp_path / "two"


def run(url, *inputs, **options):
    return run_collection(url, Options(inputs=inputs, workers=Workers("threads", 2), **options), FAKE)


def test_a_run_on_s3_is_that_on_a_disk(bucket, captures, tmp_path, calls):
    assert run(bucket, captures).counts == {"done": 7}
    run(tmp_path / "col", captures)
    remote, local = open_collection(bucket), open_collection(tmp_path / "col")
    for kind in ("calibration", "lightfield", "disparity"):
        assert remote.open(kind).load().identical(local.open(kind).load())
    storage = open_storage(bucket)
    for name in storage.files_below("lightfield.zarr"):
        assert storage.read(name) == (tmp_path / "col" / name).read_bytes(), name
    calls.write_text("")
    assert run(bucket, captures).counts == {"kept": 7}
    assert calls.read_text() == ""
    assert validate(remote) == []
    names = storage.files_below("")
    assert len(names) > 30
    assert not [name for name in names if SECRET.encode() in storage.read(name)]


def test_it_grows_and_heals_as_on_a_disk(bucket, pair):
    run(bucket, pair)
    storage = open_storage(bucket)
    before = {name: storage.read(name) for name in storage.files_below("disparity.zarr") if "/disparity/c/" in name}
    write_capture(pair / "NEW.lfp", seed=99)
    assert run(bucket, pair).counts == {"done": 2, "kept": 3}
    assert {name: storage.read(name) for name in before} == before
    victim = sorted(before)[0]
    storage.write(victim, before[victim][:-1] + bytes([before[victim][-1] ^ 1]))
    assert [finding.what for finding in validate(open_collection(bucket))] == ["disparity"]
    assert run(bucket).counts["done"] == 1
    assert storage.read(victim) == before[victim]


def lfflow(*arguments):
    """Standard output of a command that must succeed, in a process of its own."""
    command = [sys.executable, "-m", "lfflow", *map(str, arguments)]
    done = subprocess.run(command, capture_output=True, text=True, timeout=600)
    assert done.returncode == 0, done.stderr
    return done.stdout


def test_every_command_works_on_a_bucket(bucket, tmp_path):
    simulate_collection(tmp_path / "raw", captures=2, height=320, width=320)
    assert json.loads(lfflow("scan", tmp_path / "raw", "--json", "--out", bucket))["kinds"] == {"scene": 2, "white": 1}
    run_it = ("run", tmp_path / "raw", "--workers", "processes:2", "--json", "--out")
    assert json.loads(lfflow(*run_it, bucket))["counts"] == {"done": 5}
    assert json.loads(lfflow(*run_it, bucket))["counts"] == {"kept": 5}
    told = json.loads(lfflow("status", bucket, "--json"))
    assert told["stages"]["disparity"] == {"done": 2}
    assert "the nearest of 1 white images" in lfflow("status", bucket, "--why", "IMG_0001")
    assert lfflow("query", bucket, "disparity_state == 'done'").split() == ["IMG_0001", "IMG_0002"]
    assert "nothing to do" in lfflow("plan", bucket)
    assert lfflow("validate", bucket) == "everything is whole\n"
    assert lfflow("migrate", bucket) == "every store has the present schema\n"
    assert lfflow("quicklook", bucket, "--where", "id == 'IMG_0001'") == f"{bucket}/quicklook/IMG_0001.png\n"
    assert lfflow("report", bucket) == f"{bucket}/report.html\n"
    assert open_storage(bucket).read("report.html").count(b"data:image/jpeg;base64,") == 2
    written = lfflow("export", bucket, "--format", "pfm", "--out", tmp_path / "out").split()
    assert [Path(path).is_file() for path in written] == [True, True]


def test_one_run_at_a_time(bucket):
    storage = open_storage(bucket)
    with run_lease(storage), pytest.raises(CollectionError, match="another run works on s3://lab"):
        run(bucket)
    with run_lease(storage):
        pass


def test_of_many_that_put_one_object_at_once_one_succeeds(bucket):
    """What the lease rests on: S3 has no rename, but it puts an object only if there is none."""
    from concurrent.futures import ThreadPoolExecutor

    storage = open_storage(bucket)
    for number in range(5):
        with ThreadPoolExecutor(8) as rivals:
            won = list(rivals.map(lambda rival, n=number: storage.create(f"race/{n}", b"%d" % rival), range(8)))
        assert sum(won) == 1
        assert storage.read(f"race/{number}") == b"%d" % won.index(True)
