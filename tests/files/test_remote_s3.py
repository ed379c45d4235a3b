"""Reading from S3 where it is not plain: a server on loopback that refuses, fails, and never ends its lists."""

import http.server
import random
import re
import threading
import urllib.parse
from types import SimpleNamespace
from xml.sax.saxutils import escape

import fsspec
import fsspec.config
import pytest

from jaxscan.errors import CaptureError
from jaxscan.files import remote
from jaxscan.files.remote import fetch_file, fetch_folder, find_captures, remote_digest

from .test_remote import contents


GIGABYTE = 1 << 30
ROOM = {"capture.toml": b"kind", "frames.jsonl": b"", **{f"on/{k:06}.zst": bytes([k]) * (k + 1) for k in range(60)}}
OWN_SECTION = "[default]\nregion = us-east-1\n"


class Handler(http.server.BaseHTTPRequestHandler):
    """One bucket, `rooms`, of the files of its server; `rule(handler)` may answer first."""

    protocol_version = "HTTP/1.1"

    def log_message(self, *ignored):
        pass

    def answer(self, status, body=b"", **headers):
        self.send_response(status)
        for name, value in {"Content-Length": str(len(body)), **headers}.items():
            self.send_header(name.replace("_", "-"), value)
        self.end_headers()
        if self.command != "HEAD":
            self.wfile.write(body)

    def refuse(self, status, code, text):
        self.answer(status, f"<Error><Code>{code}</Code><Message>{text}</Message></Error>".encode())

    def do_HEAD(self):
        self.do_GET()

    def do_GET(self):
        url = urllib.parse.urlsplit(self.path)
        self.key = urllib.parse.unquote(url.path).removeprefix("/rooms").lstrip("/")
        self.query = dict(urllib.parse.parse_qsl(url.query))
        store = self.server.store
        self.listed = "list-type" in self.query
        signed = re.search(r"Credential=([^/]+)/", self.headers.get("Authorization", ""))
        # Only the faster client reads without the header that all of botocore have.
        fast = "amz-sdk-invocation-id" not in self.headers
        store.asked.append((self.command, self.key, signed and signed[1], fast))
        if store.rule(self):
            return
        if self.listed:
            self.list()
        elif self.key not in store.files:
            self.refuse(404, "NoSuchKey", "none")
        else:
            self.read(store.files[self.key])

    def read(self, content):
        start, end = 0, len(content)
        if wanted := re.fullmatch(r"bytes=(\d+)-(\d+)", self.headers.get("Range", "")):
            start, end = int(wanted[1]), int(wanted[2]) + 1
        about = {"ETag": '"tag"', "Last_Modified": "Wed, 21 Oct 2015 07:28:00 GMT"}
        if wanted:
            about["Content_Range"] = f"bytes {start}-{end - 1}/{len(content)}"
        self.answer(206 if wanted else 200, content[start:end], **about)

    def list(self):
        above = self.query.get("prefix", "")
        below = [key.removeprefix(above) for key in self.server.store.files if key.startswith(above)]
        folders = sorted({key.split("/")[0] for key in below if "/" in key})
        self.entries(
            [(above + key, len(self.server.store.files[above + key])) for key in below if "/" not in key],
            [f"{above}{folder}/" for folder in folders],
        )

    def entries(self, files, folders=(), following=None):
        more = f"<NextContinuationToken>{following}</NextContinuationToken>" if following else ""
        text = f"<ListBucketResult><IsTruncated>{'true' if following else 'false'}</IsTruncated>{more}"
        for key, size in files:
            text += f'<Contents><Key>{escape(key)}</Key><Size>{size}</Size><ETag>"tag"</ETag></Contents>'
        for key in folders:
            text += f"<CommonPrefixes><Prefix>{escape(key)}</Prefix></CommonPrefixes>"
        self.answer(200, f"{text}</ListBucketResult>".encode(), Content_Type="application/xml")


@pytest.fixture(scope="module")
def server():
    """A server on loopback, in threads of this process."""
    with http.server.ThreadingHTTPServer(("127.0.0.1", 0), Handler) as server:
        server.daemon_threads = True
        thread = threading.Thread(target=server.serve_forever, daemon=True)
        thread.start()
        yield server
        server.shutdown()
        thread.join()


@pytest.fixture
def store(server, monkeypatch, tmp_path):
    """The files of the bucket, what was asked for them, and a rule; all drivers know the server and a key."""
    for name, value in {
        "AWS_ENDPOINT_URL": f"http://127.0.0.1:{server.server_port}",
        "AWS_ACCESS_KEY_ID": "session",
        "AWS_SECRET_ACCESS_KEY": "nothing",
        "AWS_DEFAULT_REGION": "us-east-1",
        "AWS_CONFIG_FILE": str(tmp_path / "config"),
        "AWS_EC2_METADATA_DISABLED": "true",
    }.items():
        monkeypatch.setenv(name, value)
    for name in ("AWS_PROFILE", "AWS_SESSION_TOKEN", "AWS_CA_BUNDLE"):
        monkeypatch.delenv(name, raising=False)
    monkeypatch.setattr(remote, "WAITS_S", (0.0,) * len(remote.WAITS_S))
    store = SimpleNamespace(files={}, asked=[], rule=lambda handler: False, config=tmp_path / "config")
    store.files = {f"one/{name}": content for name, content in ROOM.items()}
    server.store = store
    kind = fsspec.get_filesystem_class("s3")
    kind.clear_instance_cache()
    yield store
    kind.clear_instance_cache()


def asked_for_files(store):
    """(key of the user, whether by the faster client) of the requests of contents."""
    return {(user, fast) for command, key, user, fast in store.asked if command == "GET" and key}


def test_a_capture_is_read_by_the_faster_client(store, tmp_path):
    fetch_folder("s3://rooms/one", tmp_path / "one", most_bytes=GIGABYTE)
    assert contents(tmp_path / "one") == ROOM
    assert asked_for_files(store) == {("session", True)}


@pytest.mark.parametrize(
    ("status", "code", "message"),
    [(403, "AccessDenied", "You may not."), (401, "Unauthorized", "Who are you?"), (403, "OwnWord", "Go away.")],
)
def test_what_is_refused_is_said_at_once_in_a_plain_line(store, tmp_path, status, code, message):
    def rule(handler):
        if refused := not handler.listed and handler.command == "GET":
            handler.refuse(status, code, message)
        return refused

    store.rule = rule
    with pytest.raises(CaptureError) as caught:
        fetch_file("s3://rooms/one/on/000003.zst", tmp_path / "file", most_bytes=100)
    said = str(caught.value)
    assert said.startswith("s3://rooms/one/on/000003.zst: cannot be read: ") and message.rstrip(".") in said
    assert said.isprintable() and "<" not in said and len(said) < 200
    # Once by each of the clients.
    tries = [fast for command, key, _, fast in store.asked if command == "GET" and key]
    assert tries == [True, False]


def test_what_may_not_be_listed_is_said_at_once(store):
    def rule(handler):
        handler.refuse(401, "Unauthorized", "Who are you?")
        return True

    store.rule = rule
    with pytest.raises(CaptureError, match=r"rooms/one: cannot be read: .*Who are you"):
        fetch_folder("s3://rooms/one", store.config.parent / "one", most_bytes=GIGABYTE)
    assert len(store.asked) == 1


def test_controls_of_a_terminal_are_left_out_of_messages():
    def red():
        raise ValueError("\x1b[31mred\u202e\x00\nline")

    with pytest.raises(CaptureError, match=r"^one: cannot be read: \[31mred line\.$"):
        remote.asked(red, remote.StoragePlace(SimpleNamespace(invalidate_cache=lambda path: None), "one", "one"))


def test_a_server_that_fails_one_time_in_twenty_is_read_whole(store, tmp_path):
    generator = random.Random(7)
    failures = []

    def rule(handler):
        if failed := generator.random() < 0.05:
            failures.append(handler.path)
            if len(failures) % 2:
                handler.refuse(503, "SlowDown", "Later.")
            else:
                handler.close_connection = True
        return failed

    store.rule = rule
    for name in ("a", "b"):
        fetch_folder("s3://rooms/one", tmp_path / name, most_bytes=GIGABYTE)
        assert contents(tmp_path / name) == ROOM
    assert len(failures) >= 4


def test_after_a_failure_the_driver_reads_the_rest(store, tmp_path):
    """A bucket in another region is one that the faster client cannot follow."""

    def rule(handler):
        if moved := "amz-sdk-invocation-id" not in handler.headers:
            handler.refuse(301, "PermanentRedirect", "elsewhere")
        return moved

    store.rule = rule
    fetch_folder("s3://rooms/one", tmp_path / "one", most_bytes=GIGABYTE)
    assert contents(tmp_path / "one") == ROOM
    assert sum(fast for *_, fast in store.asked) <= remote.WORKERS


def test_keys_given_to_the_driver_are_used_and_no_others(store, tmp_path, monkeypatch):
    monkeypatch.setitem(fsspec.config.conf, "s3", {"key": "given", "secret": "nothing"})
    fetch_folder("s3://rooms/one", tmp_path / "one", most_bytes=GIGABYTE)
    assert contents(tmp_path / "one") == ROOM
    assert asked_for_files(store) == {("given", True)}
    assert {user for _, _, user, _ in store.asked} == {"given"}


def test_keys_given_to_the_driver_are_enough(store, tmp_path, monkeypatch):
    monkeypatch.delenv("AWS_ACCESS_KEY_ID")
    monkeypatch.delenv("AWS_SECRET_ACCESS_KEY")
    monkeypatch.setenv("AWS_SHARED_CREDENTIALS_FILE", str(tmp_path / "none"))
    monkeypatch.setitem(fsspec.config.conf, "s3", {"key": "given", "secret": "nothing"})
    fetch_folder("s3://rooms/one", tmp_path / "one", most_bytes=GIGABYTE)
    assert asked_for_files(store) == {("given", True)}


def test_a_public_bucket_is_read_without_a_key(store, tmp_path, monkeypatch):
    monkeypatch.setitem(fsspec.config.conf, "s3", {"anon": True})
    fetch_folder("s3://rooms/one", tmp_path / "one", most_bytes=GIGABYTE)
    assert asked_for_files(store) == {(None, True)}


def test_the_environment_does_not_lead_to_another_server_or_key(store, server, tmp_path, monkeypatch):
    """Where the driver was told its server, variables that its library would read count for neither client."""
    given = {"key": "given", "secret": "nothing", "endpoint_url": f"http://127.0.0.1:{server.server_port}"}
    monkeypatch.setitem(fsspec.config.conf, "s3", given)
    for name, value in {
        "AWS_ENDPOINT_URL_S3": "http://127.0.0.1:9",
        "AWS_SKIP_SIGNATURE": "true",
        "AWS_SESSION_TOKEN": "other",
        "AWS_VIRTUAL_HOSTED_STYLE_REQUEST": "true",
    }.items():
        monkeypatch.setenv(name, value)
    fetch_folder("s3://rooms/one", tmp_path / "one", most_bytes=GIGABYTE)
    assert contents(tmp_path / "one") == ROOM
    assert asked_for_files(store) == {("given", True)}


@pytest.mark.parametrize(
    ("address", "profile", "given"),
    [
        ("s3://rooms/one", "", {"client_kwargs": {"verify": False}}),
        ("s3://rooms/one", "", {"config_kwargs": {"s3": {"addressing_style": "virtual"}}}),
        ("s3://rooms/one", "", {"requester_pays": True}),
        ("s3://rooms/one", "", {"s3_additional_kwargs": {"SSECustomerKey": "x"}}),
        ("s3://rooms/one", "", {"endpoint_url": "https://127.0.0.1:9", "ca": True}),
        ("s3://rooms/one", "s3 =\n  addressing_style = virtual\n", {}),
        ("s3://rooms/one", "s3 =\n  use_accelerate_endpoint = true\n", {}),
        ("s3://rooms/one", "s3 =\n  signature_version = s3\n", {}),
        ("s3://rooms/one", "use_fips_endpoint = true\n", {}),
        ("s3://arn:aws:s3:us-east-1:123456789012:accesspoint/mine/one", "", {}),
        ("s3://Rooms/one", "", {}),
    ],
)
def test_what_is_not_plain_is_read_by_the_driver(store, monkeypatch, address, profile, given):
    given = dict(given)
    if given.pop("ca", False):
        monkeypatch.setenv("AWS_CA_BUNDLE", "/own/authority.pem")
    if "fips" in profile:
        monkeypatch.delenv("AWS_ENDPOINT_URL")
    store.config.write_text(OWN_SECTION + profile)
    monkeypatch.setitem(fsspec.config.conf, "s3", given)
    monkeypatch.setattr(fsspec.get_filesystem_class("s3"), "connect_timeout", 1)
    assert remote.reader_of(remote.open_place(address)) is remote.by_driver
    assert store.asked == []


def test_a_plain_profile_is_read_by_the_faster_client(store):
    store.config.write_text(OWN_SECTION + "s3 =\n  addressing_style = path\n")
    assert remote.reader_of(remote.open_place("s3://rooms/one")) is not remote.by_driver


def test_lists_without_end_are_left_after_a_page_too_many(store, monkeypatch):
    monkeypatch.setattr(remote, "MAX_FILES", 10)
    numbers = iter(range(10**6))

    def rule(handler):
        if handler.listed:
            handler.entries([(f"{handler.query['prefix']}{next(numbers)}", 1) for _ in range(4)], following="more")
        return handler.listed

    store.rule = rule
    for ask in (find_captures, remote_digest):
        store.asked.clear()
        with pytest.raises(CaptureError, match=r"s3://rooms/one.*: holds more than 10 files"):
            ask("s3://rooms/one/*" if ask is find_captures else "s3://rooms/one")
        assert len(store.asked) <= 6


def test_empty_pages_without_end_are_left(store):
    def rule(handler):
        handler.entries([], following="more")
        return True

    store.rule = rule
    with pytest.raises(CaptureError, match="holds more than 10 files"):
        remote.listed(remote.open_place("s3://rooms/one"), 10)


def test_pages_are_put_together(store, tmp_path):
    keys = sorted(key for key in store.files if key.startswith("one/on/"))

    def rule(handler):
        if paged := handler.listed and handler.query["prefix"] == "one/on/":
            start = int(handler.query.get("continuation-token", 0))
            part = [(key, len(store.files[key])) for key in keys[start : start + 25]]
            handler.entries(part, following=start + 25 if start + 25 < len(keys) else None)
        return paged

    store.rule = rule
    fetch_folder("s3://rooms/one", tmp_path / "one", most_bytes=GIGABYTE)
    assert contents(tmp_path / "one") == ROOM
