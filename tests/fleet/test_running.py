"""A cluster that runs already: certificates, addresses where nobody answers, and other versions."""

import contextlib
import datetime
import os
import socket
import ssl
import stat
import threading
from pathlib import Path

import distributed
import pytest
from cryptography import x509

from jaxscan.errors import OptionError, OutputError
from jaxscan.fleet import ClusterChoice, make_certificates, open_cluster
from jaxscan.fleet.clusters import running as module
from jaxscan.fleet.clusters.certificates import security_of


pytestmark = pytest.mark.rig


@pytest.fixture
def soon(monkeypatch):
    """What does not answer is given up after a second."""
    monkeypatch.setattr(module, "ANSWER_S", 1.0)


@contextlib.contextmanager
def cluster(certificates=None, workers=1):
    """A scheduler and workers in threads of this process, as somebody else may have started them."""
    security = distributed.Security(**security_of(certificates)) if certificates else None
    with distributed.LocalCluster(
        n_workers=workers,
        threads_per_worker=1,
        processes=False,
        host="127.0.0.1",
        protocol="tls://" if certificates else "tcp://",
        security=security,
        dashboard_address="127.0.0.1:0",
        memory_limit=0,
    ) as cluster:
        yield cluster


@pytest.fixture(scope="module")
def certificates(tmp_path_factory):
    return make_certificates(tmp_path_factory.mktemp("tls") / "mine")


@pytest.fixture(scope="module")
def address(certificates):
    with cluster(certificates) as running:
        yield running.scheduler_address


def test_who_holds_the_certificate_may_connect(address, certificates):
    folder = os.path.dirname(certificates.ca)
    with open_cluster(ClusterChoice(address=address, tls=Path(folder))) as client:
        assert client.submit(sum, (2, 3)).result(timeout=20) == 5
    # It stays when the client has gone.
    with open_cluster(ClusterChoice(address=address, tls=Path(folder))) as client:
        assert len(client.scheduler_info()["workers"]) == 1


def test_a_certificate_of_another_authority_is_refused(address, tmp_path, soon):
    make_certificates(tmp_path / "other")
    choice = ClusterChoice(address=address, tls=tmp_path / "other")
    with pytest.raises(OptionError, match="does not know this certificate"), open_cluster(choice):
        pytest.fail("connected")


def test_without_a_certificate_nobody_is_heard(address, certificates, soon):
    plain = ClusterChoice(address=address.replace("tls://", "tcp://"))
    with pytest.raises(OptionError, match="no scheduler of Dask answers"), open_cluster(plain):
        pytest.fail("connected")
    # One who trusts the authority but has no certificate to show.
    host, port = address.removeprefix("tls://").split(":")
    context = ssl.create_default_context(cafile=certificates.ca)
    context.check_hostname = False
    with socket.create_connection((host, int(port)), timeout=10) as plain, context.wrap_socket(plain) as encrypted:
        with pytest.raises(OSError, match=r"(?i)certificate required|reset|closed|eof"):
            encrypted.sendall(b"\0" * 64)
            if not encrypted.recv(64):
                raise OSError("closed")


def test_certificates_are_private_and_there_can_be_no_others(certificates):
    folder = os.path.dirname(certificates.ca)
    assert stat.S_IMODE(os.stat(folder).st_mode) == 0o700
    assert sorted(os.listdir(folder)) == ["ca.pem", "cert.pem", "key.pem"]
    assert {stat.S_IMODE(os.stat(path).st_mode) for path in certificates} == {0o600}
    ca, cert, key = (Path(path).read_text() for path in certificates)
    assert "PRIVATE KEY" in key and "PRIVATE KEY" not in ca + cert
    authority, signed = (x509.load_pem_x509_certificate(text.encode()) for text in (ca, cert))
    signed.verify_directly_issued_by(authority)
    # The key in the folder is that of the cluster: with it nothing can be signed that others would trust.
    assert not signed.extensions.get_extension_for_class(x509.BasicConstraints).value.ca
    now = datetime.datetime.now(datetime.UTC)
    assert signed.not_valid_before_utc < now < signed.not_valid_after_utc < now + datetime.timedelta(days=31)


def test_certificates_replace_none(certificates):
    with pytest.raises(OutputError, match="cannot be made"):
        make_certificates(os.path.dirname(certificates.ca))


def test_unfit_files_of_certificates_are_one_line(certificates, tmp_path):
    folder = tmp_path / "tls"
    folder.mkdir()
    choice = ClusterChoice(address="tls://127.0.0.1:1", tls=folder)
    with pytest.raises(OptionError, match=r"ca\.pem"), open_cluster(choice):
        pytest.fail("connected")
    for path in certificates:
        (folder / os.path.basename(path)).write_text("nothing\n")
    with pytest.raises(OptionError, match="holds no certificates that belong together"), open_cluster(choice):
        pytest.fail("connected")


def test_where_nobody_listens_is_one_line(soon):
    with socket.socket() as free:
        free.bind(("127.0.0.1", 0))
        address = f"tcp://127.0.0.1:{free.getsockname()[1]}"
        with pytest.raises(OptionError, match="no scheduler of Dask answers") as caught:
            with open_cluster(ClusterChoice(address=address)):
                pytest.fail("connected")
    assert "\n" not in str(caught.value)


@pytest.mark.parametrize("answer", [None, b"HTTP/1.1 400 Bad Request\r\n\r\n", b"\xff" * 4096, b"\0" * 4096])
def test_what_is_no_scheduler_is_one_line(answer, soon):
    def serve(listening):
        while True:
            try:
                connection, _ = listening.accept()
            except OSError:
                return
            kept.append(connection)
            if answer is not None:
                with contextlib.suppress(OSError):
                    connection.sendall(answer)

    kept = []
    with socket.create_server(("127.0.0.1", 0)) as listening:
        thread = threading.Thread(target=serve, args=(listening,))
        thread.start()
        try:
            choice = ClusterChoice(address=f"tcp://127.0.0.1:{listening.getsockname()[1]}")
            with pytest.raises(OptionError, match="no scheduler of Dask answers"), open_cluster(choice):
                pytest.fail("connected")
        finally:
            listening.shutdown(socket.SHUT_RDWR)
            thread.join()
            for connection in kept:
                connection.close()


def test_the_address_of_a_worker_is_one_line(certificates, soon):
    with cluster() as found:
        worker = next(iter(found.workers.values())).address
        with pytest.raises(OptionError, match="found a 'Worker' of Dask"), open_cluster(ClusterChoice(address=worker)):
            pytest.fail("opened")


def test_a_cluster_without_workers_is_one_line(soon):
    with cluster(workers=0) as empty:
        choice = ClusterChoice(address=empty.scheduler_address)
        with pytest.raises(OptionError, match="no worker came within 1 s; start workers for tcp://"):
            with open_cluster(choice):
                pytest.fail("opened")
