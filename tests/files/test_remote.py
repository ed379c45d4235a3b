"""Captures on storage behind fsspec: memory, a file system that fails, hostile listings, and S3 on loopback."""

import random
import sys
import threading

import boto3
import fsspec
import numpy as np
import pytest
from fsspec.implementations.memory import MemoryFileSystem

from jaxscan import open_capture
from jaxscan.errors import CaptureError, DependencyError
from jaxscan.files import remote
from jaxscan.files.remote import (
    fetch_file,
    fetch_folder,
    find_captures,
    is_remote,
    remote_digest,
)


GIGABYTE = 1 << 30


class OwnStore(MemoryFileSystem):
    """Files in memory under a scheme of its own; `calls` counts what was asked of it."""

    protocol = "own"
    store: dict = {}  # noqa: RUF012
    pseudo_dirs = [""]  # noqa: RUF012
    calls = 0
    lock = threading.Lock()

    @classmethod
    def _strip_protocol(cls, path):
        return MemoryFileSystem._strip_protocol(path.replace(f"{cls.protocol}://", "memory://"))  # noqa: SLF001

    def asked(self):
        with self.lock:
            type(self).calls += 1

    def ls(self, path, detail=True, **options):
        self.asked()
        return super().ls(path, detail, **options)

    def info(self, path, **options):
        self.asked()
        return super().info(path, **options)

    def cat_file(self, path, start=None, end=None, **options):
        self.asked()
        return super().cat_file(path, start, end, **options)


@pytest.fixture(autouse=True)
def quick(monkeypatch):
    """As many tries, without the pauses between them."""
    monkeypatch.setattr(remote, "WAITS_S", (0.0,) * len(remote.WAITS_S))


def register(scheme, **methods):
    """A kind of `OwnStore` with some of its methods replaced; it is empty."""
    kind = type("Store", (OwnStore,), {"protocol": scheme, "store": {}, "pseudo_dirs": [""], **methods})
    fsspec.register_implementation(scheme, kind, clobber=True)
    return kind


def fill(address, files):
    store, path = fsspec.url_to_fs(address)
    for name, content in files.items():
        # What a listing would have, without what a program that writes there would refuse.
        store.store[f"{path}/{name}"] = fsspec.implementations.memory.MemoryFile(store, f"{path}/{name}", content)
    return store


def contents(folder):
    return {p.relative_to(folder).as_posix(): p.read_bytes() for p in sorted(folder.rglob("*")) if p.is_file()}


ROOM = {"capture.toml": b"kind", "frames.jsonl": b"", **{f"on/{k:06}.zst": bytes([k]) * (k + 1) for k in range(60)}}


@pytest.mark.parametrize("address", ["s3://bucket/rooms", "memory://a", "file:///tmp", "gcs://b", "a.b+c-1://x"])
def test_an_address_has_a_scheme(address):
    assert is_remote(address)


@pytest.mark.parametrize("path", ["", "rooms", "/rooms", "C:\\rooms", "C:/rooms", "C://rooms", "./s3://b", "s3:/b"])
def test_a_path_has_none(path):
    assert not is_remote(path)


def test_a_folder_is_copied(tmp_path):
    register("own")
    fill("own://rooms/one", ROOM)
    fetch_folder("own://rooms/one", tmp_path / "one", most_bytes=GIGABYTE)
    assert contents(tmp_path / "one") == ROOM


def test_large_files_are_copied_in_blocks(tmp_path, monkeypatch):
    monkeypatch.setattr(remote, "BLOCK_BYTES", 7)
    blocks = []

    def cat_file(self, path, start=None, end=None):
        blocks.append(end - start)
        return MemoryFileSystem.cat_file(self, path, start, end)

    register("own", cat_file=cat_file)
    fill("own://rooms/one", ROOM)
    fetch_folder("own://rooms/one", tmp_path / "one", most_bytes=GIGABYTE)
    assert contents(tmp_path / "one") == ROOM
    assert max(blocks) == 7


def test_stripes_that_fit_no_copy_are_left_out(tmp_path):
    register("own")
    fill("own://one", ROOM)
    digest = remote_digest("own://one")
    fill("own://one", {"stripes.npz": b"stripes"})
    fetch_folder("own://one", tmp_path / "one", most_bytes=GIGABYTE)
    assert contents(tmp_path / "one") == ROOM
    assert remote_digest("own://one") == digest


def test_captures_are_found_by_patterns():
    register("own")
    for name in ("rooms/b", "rooms/a", "rooms/a/inner", "rooms/c-1", "other/a"):
        fill(f"own://top/{name}", ROOM)
    fill("own://top/rooms/empty", {"frames.jsonl": b""})
    fill("own://top/rooms", {"notes.txt": b"", "capture.toml/inside": b""})
    assert find_captures("own://top/rooms/*") == [f"own://top/rooms/{name}" for name in ("a", "b", "c-1")]
    assert find_captures("own://top/*/a/") == ["own://top/other/a", "own://top/rooms/a"]
    assert find_captures("own://top/rooms/[ab]") == ["own://top/rooms/a", "own://top/rooms/b"]
    assert find_captures("own://top/rooms/c-?") == ["own://top/rooms/c-1"]
    assert find_captures("own://top/rooms/a") == ["own://top/rooms/a"]
    assert find_captures("own://top/nowhere/*") == find_captures("own://top/rooms/empty") == []
    assert find_captures("own://*/rooms/a") == ["own://top/rooms/a"]


def test_captures_on_this_disk_are_found_by_an_address(tmp_path):
    for name in ("b", "a"):
        (tmp_path / name).mkdir()
        (tmp_path / name / "capture.toml").touch()
    assert find_captures(f"file://{tmp_path}/*") == [f"file://{tmp_path}/{name}" for name in ("a", "b")]


def test_a_pattern_that_finds_too_much_is_refused(monkeypatch):
    monkeypatch.setattr(remote, "MAX_FOUND", 3)
    register("own")
    for k in range(4):
        fill(f"own://rooms/{k}", ROOM)
    with pytest.raises(CaptureError, match="finds more than 3 folders"):
        find_captures("own://rooms/*")
    with pytest.raises(CaptureError, match=r"found \*\*, expected one"):
        find_captures("own://rooms/**")


def test_a_digest_changes_with_the_listing():
    kind = register("own")
    fill("own://one", ROOM)
    digest = remote_digest("own://one")
    assert digest.startswith("sha256:") and len(digest) == 71
    kind.calls = 0
    assert remote_digest("own://one") == digest
    # One look at the address, and one list of each of its two folders.
    assert kind.calls == 3
    fill("own://one", {"on/000000.zst": b"other"})
    changed = remote_digest("own://one")
    assert changed != digest
    fill("own://one", {"on/more": b""})
    assert remote_digest("own://one") not in (digest, changed)
    assert remote_digest("own://one/on/more") == remote_digest("own://one/on/more") != remote_digest("own://one/on")


def test_a_listing_without_marks_of_change_has_no_digest():
    register("own", info=lambda self, path, **options: {"name": path, "type": "file", "size": 3})
    with pytest.raises(CaptureError, match="neither ETag nor time of change"):
        remote_digest("own://one")


def one_in_twenty(seed):
    """A method that fails with a probability of 1/20."""
    generator = random.Random(seed)

    def asked(self):
        with self.lock:
            type(self).calls += 1
            if generator.random() < 0.05:
                type(self).failures += 1
                raise (OSError if generator.random() < 0.5 else TimeoutError)("the network is away")

    return asked


def test_storage_that_fails_one_read_in_twenty_is_read_whole(tmp_path):
    kind = register("own", asked=one_in_twenty(seed=20), failures=0)
    for name in ("a", "b", "c"):
        fill(f"own://rooms/{name}", ROOM)
    assert find_captures("own://rooms/*") == [f"own://rooms/{name}" for name in ("a", "b", "c")]
    for name in ("a", "b", "c"):
        assert remote_digest(f"own://rooms/{name}") == remote_digest(f"own://rooms/{name}")
        fetch_folder(f"own://rooms/{name}", tmp_path / name, most_bytes=GIGABYTE)
        assert contents(tmp_path / name) == ROOM
        fetch_file(f"own://rooms/{name}/on/000059.zst", tmp_path / f"{name}.zst", most_bytes=60)
        assert (tmp_path / f"{name}.zst").read_bytes() == ROOM["on/000059.zst"]
    assert kind.failures >= 5


def test_storage_that_cuts_reads_short_is_asked_again(tmp_path):
    short = iter([0, 3, 5, 9])

    def cat_file(self, path, start=None, end=None):
        return MemoryFileSystem.cat_file(self, path, start, end)[: next(short, None)]

    register("own", cat_file=cat_file)
    fill("own://rooms", {"cloud.ply": b"0123456789"})
    fetch_file("own://rooms/cloud.ply", tmp_path / "cloud.ply", most_bytes=10)
    assert (tmp_path / "cloud.ply").read_bytes() == b"0123456789"


def test_storage_that_always_fails_is_asked_five_times_and_said(tmp_path):
    tries = []

    def cat_file(self, path, start=None, end=None):
        tries.append(path)
        raise OSError("the disk\nis away")

    register("own", cat_file=cat_file)
    fill("own://rooms", {"cloud.ply": b"0123456789"})
    (tmp_path / "cloud.ply").write_bytes(b"old")
    with pytest.raises(CaptureError) as caught:
        fetch_file("own://rooms/cloud.ply", tmp_path / "cloud.ply", most_bytes=10)
    assert str(caught.value) == "own://rooms/cloud.ply: cannot be read: the disk is away."
    assert len(tries) == 5
    assert contents(tmp_path) == {"cloud.ply": b"old"}
    with pytest.raises(CaptureError, match=r"own://rooms/cloud.ply: cannot be read: the disk is away\."):
        fetch_folder("own://rooms", tmp_path / "folder", most_bytes=10)
    assert contents(tmp_path / "folder") == {}


def test_pauses_between_tries_grow(monkeypatch):
    waited = []
    monkeypatch.undo()
    monkeypatch.setattr(remote.time, "sleep", waited.append)

    def info(self, path, **options):
        raise TimeoutError

    register("own", info=info)
    with pytest.raises(CaptureError, match="own://one: cannot be read: TimeoutError"):
        remote_digest("own://one")
    assert len(waited) == 4 and waited == sorted(set(waited)) and sum(waited) < 5


def test_what_is_not_there_is_asked_for_once(tmp_path):
    kind = register("own")
    for ask in (remote_digest, lambda address: fetch_file(address, tmp_path / "file", most_bytes=1)):
        kind.calls = 0
        with pytest.raises(CaptureError, match="own://nothing: cannot be read: no such file or folder"):
            ask("own://nothing")
        assert kind.calls == 1
    with pytest.raises(CaptureError, match="own://nothing: cannot be read: no such file or folder"):
        fetch_folder("own://nothing", tmp_path / "folder", most_bytes=1)
    assert not (tmp_path / "folder").exists()


def test_what_is_refused_is_asked_for_once():
    tries = []

    def info(self, path, **options):
        tries.append(path)
        raise PermissionError("Access Denied")

    register("own", info=info)
    with pytest.raises(CaptureError, match=r"own://one: cannot be read: Access Denied\."):
        remote_digest("own://one")
    assert len(tries) == 1


def listed(*entries):
    """A method that lists what somebody made up, one folder deep."""

    def ls(self, path, detail=True, **options):
        return [{"type": "file", "size": 1, "created": 1.0, **entry} for entry in entries]

    return ls


@pytest.mark.parametrize(
    ("name", "message"),
    [
        ("/one/../../escaped", "no name of a file in it"),
        ("/one/..", "no name of a file in it"),
        ("/one/.", "no name of a file in it"),
        ("/one//a", "no name of a file in it"),
        ("/one/a/b", "no name of a file in it"),
        ("/one/..\\escaped", "no name of a file in it"),
        ("/one/C:escaped", "no name of a file in it"),
        ("/one/a\nb", "no name of a file in it"),
        ("/one/a\x00", "no name of a file in it"),
        ("/one/\udcff", "no name of a file in it"),
        ("/etc/passwd", "no name of a file in it"),
        ("/oneself/a", "no name of a file in it"),
        ("/one", "found a file, expected a folder"),
    ],
)
def test_names_that_lead_elsewhere_are_refused(tmp_path, name, message):
    register("own", ls=listed({"name": "/one/good"}, {"name": name}))
    with pytest.raises(CaptureError, match=message) as caught:
        fetch_folder("own://one", tmp_path / "inside" / "one", most_bytes=GIGABYTE)
    assert "\n" not in str(caught.value)
    assert list(tmp_path.iterdir()) == []


@pytest.mark.parametrize(
    ("entries", "message"),
    [
        ([{"name": "/one/a", "type": "link"}], "is a link or a device"),
        ([{"name": "/one/a", "islink": True}], "is a link or a device"),
        ([{"name": "/one/a", "type": "other"}], "is a link or a device"),
        ([{"name": "/one/a"}, {"name": "/one/A"}], "differ in spelling alone: 'a'"),
        ([{"name": "/one/\u00e9"}, {"name": "/one/e\u0301"}], "differ in spelling alone"),
        ([{"name": "/one/a"}, {"name": "/one/a"}], "differ in spelling alone"),
        ([{"name": "/one/a", "size": None}], "its storage says no size"),
        ([{"name": "/one/a", "size": -1}], "its storage says no size"),
        ([{"name": "/one/a", "created": None}], "neither ETag nor time of change"),
        ([{"name": "/one/a", "size": 600}, {"name": "/one/b", "size": 401}], "takes 1001 bytes, expected at most 1000"),
        ([{"name": f"/one/{k}"} for k in range(11)], "holds more than 10 files"),
        ([], "found no files"),
    ],
)
def test_listings_that_are_hostile_are_refused(tmp_path, monkeypatch, entries, message):
    monkeypatch.setattr(remote, "MAX_FILES", 10)
    register("own", ls=listed(*entries))
    with pytest.raises(CaptureError, match=message):
        fetch_folder("own://one", tmp_path / "one", most_bytes=1000)
    assert list(tmp_path.iterdir()) == []


def test_folders_without_end_are_refused(tmp_path):
    def ls(self, path, detail=True, **options):
        return [{"name": path + "/deeper", "size": 0, "type": "directory"}]

    register("own", ls=ls)
    with pytest.raises(CaptureError, match="folders within one another that are too deep"):
        fetch_folder("own://one", tmp_path / "one", most_bytes=1000)


def test_links_on_a_disk_are_refused(tmp_path):
    (tmp_path / "room").mkdir()
    (tmp_path / "room" / "capture.toml").write_text("kind")
    (tmp_path / "room" / "secret").symlink_to("/etc/hostname")
    with pytest.raises(CaptureError, match="secret' is a link or a device"):
        fetch_folder(f"file://{tmp_path}/room", tmp_path / "copy", most_bytes=GIGABYTE)
    assert not (tmp_path / "copy").exists()


def test_a_folder_with_files_is_left_alone(tmp_path):
    register("own")
    fill("own://one", ROOM)
    (tmp_path / "mine").touch()
    with pytest.raises(CaptureError, match="found files in it, expected an empty folder"):
        fetch_folder("own://one", tmp_path, most_bytes=GIGABYTE)
    assert contents(tmp_path) == {"mine": b""}


def test_a_change_while_copying_is_noticed(tmp_path):
    def cat_file(self, path, start=None, end=None):
        fill("own://one", {"frames.jsonl": b"more"})
        return MemoryFileSystem.cat_file(self, path, start, end)

    register("own", cat_file=cat_file)
    fill("own://one", ROOM)
    with pytest.raises(CaptureError, match="own://one: changed while it was copied"):
        fetch_folder("own://one", tmp_path / "one", most_bytes=GIGABYTE)


def test_a_place_that_cannot_be_written_is_no_failure_of_storage(tmp_path):
    kind = register("own")
    fill("own://one", ROOM)
    kind.calls = 0
    with pytest.raises(CaptureError, match=r"none/file: cannot be written: the folder .* does not exist"):
        fetch_file("own://one/capture.toml", tmp_path / "none" / "file", most_bytes=4)
    assert kind.calls == 1


@pytest.mark.parametrize(
    ("address", "message"),
    [
        ("rooms/one", "found no address of storage, expected one such as s3://bucket/folder"),
        ("zip://a::file:///tmp/a.zip", "found no address of storage"),
        ("sftp://me:secret@host/rooms", "found a password in an address"),
        ("nonesuch://rooms", "nonesuch://rooms: cannot be opened: Protocol not known: nonesuch"),
    ],
)
def test_addresses_that_cannot_be_meant(address, message):
    with pytest.raises(CaptureError, match=message) as caught:
        remote_digest(address)
    assert "secret" not in str(caught.value)


def test_without_the_packages_it_says_what_to_install(monkeypatch):
    with monkeypatch.context() as patch:
        patch.setitem(sys.modules, "fsspec.core", None)
        with pytest.raises(DependencyError, match=r'memory:// needs fsspec: pip install "jaxscan\[fleet\]"'):
            remote_digest("memory://one")
    monkeypatch.setitem(sys.modules, "s3fs", None)
    with pytest.raises(DependencyError, match=r's3:// cannot be opened: it needs s3fs: pip install "jaxscan\[s3\]"'):
        remote_digest("s3://bucket/one")


@pytest.fixture(scope="module")
def bucket():
    """The address of an empty bucket on a server of this process, which the environment tells to all drivers."""
    from moto.server import ThreadedMotoServer

    server = ThreadedMotoServer(ip_address="127.0.0.1", port=0, verbose=False)
    server.start()
    _, port = server.get_host_and_port()
    with pytest.MonkeyPatch.context() as patch:
        patch.setenv("AWS_ENDPOINT_URL", f"http://127.0.0.1:{port}")
        patch.setenv("AWS_ACCESS_KEY_ID", "nobody")
        patch.setenv("AWS_SECRET_ACCESS_KEY", "nothing")
        patch.setenv("AWS_DEFAULT_REGION", "us-east-1")
        store = fsspec.filesystem("s3")
        store.mkdir("rooms")
        yield "s3://rooms"
        type(store).clear_instance_cache()
    server.stop()


def test_a_capture_from_s3_is_the_same_to_the_last_bit(tiny, bucket, tmp_path):
    names = contents(tiny.sweep)
    for name in names:
        fsspec.filesystem("s3").put_file(str(tiny.sweep / name), f"{bucket}/houses/one/sweep/{name}")
    # The mark of a folder, as some programs make.
    boto3.client("s3").put_object(Bucket="rooms", Key="houses/one/sweep/on/", Body=b"")
    assert find_captures(f"{bucket}/houses/*/sw*") == [f"{bucket}/houses/one/sweep"]
    digest = remote_digest(f"{bucket}/houses/one/sweep")
    fetch_folder(f"{bucket}/houses/one/sweep", tmp_path / "sweep", most_bytes=GIGABYTE)
    names.pop("stripes.npz", None)
    assert contents(tmp_path / "sweep") == names
    here, there = open_capture(tiny.sweep), open_capture(tmp_path / "sweep")
    assert here.records == there.records and here.header == there.header and len(here) == 60
    for chunk, copy in zip(here.chunks(20), there.chunks(20), strict=True):
        np.testing.assert_array_equal(chunk.on, copy.on)
        np.testing.assert_array_equal(chunk.off, copy.off)
    assert remote_digest(f"{bucket}/houses/one/sweep") == digest
    fsspec.filesystem("s3").put_file(str(tiny.config), f"{bucket}/houses/one/sweep/capture.toml")
    assert remote_digest(f"{bucket}/houses/one/sweep") != digest


def test_large_objects_go_to_s3_and_back(bucket, tmp_path, monkeypatch):
    monkeypatch.setattr(remote, "BLOCK_BYTES", 1 << 20)
    content = np.random.default_rng(4).bytes((5 << 20) + 3)
    (tmp_path / "cloud.ply").write_bytes(content)
    fsspec.filesystem("s3").put_file(str(tmp_path / "cloud.ply"), f"{bucket}/products/cloud.ply")
    fetch_file(f"{bucket}/products/cloud.ply", tmp_path / "copy.ply", most_bytes=len(content))
    assert (tmp_path / "copy.ply").read_bytes() == content
    with pytest.raises(CaptureError, match="takes 5242883 bytes, expected at most 5242882"):
        fetch_file(f"{bucket}/products/cloud.ply", tmp_path / "copy.ply", most_bytes=len(content) - 1)


@pytest.mark.parametrize("key", ["../escaped", "//escaped", "a/../../escaped", "on/..\\escaped"])
def test_hostile_keys_of_s3_are_refused(bucket, tmp_path, key):
    boto3.client("s3").put_object(Bucket="rooms", Key=f"hostile-{len(key)}/{key}", Body=b"x")
    with pytest.raises(CaptureError, match="no name of a file in it"):
        fetch_folder(f"{bucket}/hostile-{len(key)}", tmp_path / "one" / "two", most_bytes=GIGABYTE)
    assert list(tmp_path.iterdir()) == []


def test_a_file_of_s3_is_no_folder(bucket, tmp_path):
    boto3.client("s3").put_object(Bucket="rooms", Key="alone/capture.toml", Body=b"x")
    with pytest.raises(CaptureError, match=r"alone/capture\.toml: found a file, expected a folder"):
        fetch_folder(f"{bucket}/alone/capture.toml", tmp_path / "none", most_bytes=GIGABYTE)


def test_what_s3_has_not_is_said(bucket, tmp_path):
    assert find_captures(f"{bucket}/none/*") == find_captures("s3://no-such-bucket/*") == []
    for address in (f"{bucket}/none", "s3://no-such-bucket/none"):
        with pytest.raises(CaptureError, match="cannot be read: no such file or folder"):
            fetch_folder(address, tmp_path / "none", most_bytes=GIGABYTE)
