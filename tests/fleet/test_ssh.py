"""Machines by SSH: a real server on the loopback, which lets in who has the key of the test."""

import os
import stat
import subprocess
import sys
import time
from pathlib import Path

import dask
import psutil
import pytest

from jaxscan.errors import OptionError
from jaxscan.fleet import ClusterChoice, open_cluster


asyncssh = pytest.importorskip("asyncssh", reason="the extra `fleet` is not installed")

from jaxscan.fleet.clusters.choice import Host  # noqa: E402
from jaxscan.fleet.clusters.ssh import scheduler_spec, worker_specs  # noqa: E402


pytestmark = pytest.mark.rig


@pytest.fixture
def port(tmp_path, monkeypatch):
    """The port of a server on the loopback, and a home whose ~/.ssh leads there."""
    home = tmp_path / "home"
    (home / ".ssh").mkdir(parents=True, mode=0o700)
    keys = {name: asyncssh.generate_private_key("ssh-ed25519") for name in ("host", "user")}
    keys["host"].write_private_key(tmp_path / "host")
    keys["user"].write_private_key(home / ".ssh" / "id_test")
    keys["user"].write_public_key(tmp_path / "authorized")
    monkeypatch.setenv("HOME", str(home))
    monkeypatch.delenv("SSH_AUTH_SOCK", raising=False)
    # On a host it is installed.
    monkeypatch.setenv("PYTHONPATH", os.pathsep.join(path for path in sys.path if path))
    command = [sys.executable, str(Path(__file__).with_name("ssh_server.py")), str(tmp_path)]
    with subprocess.Popen(command, stdin=subprocess.PIPE, stdout=subprocess.PIPE, text=True) as server:
        try:
            port = int(server.stdout.readline())
            known = keys["host"].export_public_key().decode()
            (home / ".ssh" / "known").write_text(f"[127.0.0.1]:{port} {known}")
            (home / ".ssh" / "config").write_text(
                f"Host 127.0.0.1\n  Port {port}\n  User someone\n  IdentityFile {home}/.ssh/id_test\n"
                f"  UserKnownHostsFile {home}/.ssh/known\n"
            )
            yield port
        finally:
            server.kill()


def left():
    return {path.name for path in Path("/tmp").glob("jaxscan-*-[0-9]")}


def told_by_worker(dask_worker):
    security = dask_worker.security
    folder = Path(security.tls_worker_key).parent
    modes = {stat.S_IMODE(path.stat().st_mode) for path in (folder, *folder.iterdir())}
    lines = [" ".join(process.cmdline()) for process in psutil.process_iter() if process.pid != os.getpid()]
    secret = Path(security.tls_worker_key).read_text().splitlines()[1]
    seen = [line for line in lines if secret in line or "PRIVATE KEY" in line]
    spills = dask_worker.memory_manager.memory_spill_fraction
    return os.getpid(), str(folder), modes, seen, spills, sorted(os.sched_getaffinity(0))


@pytest.mark.slow
def test_a_whole_cluster_by_ssh(port, tmp_path):
    before = left()
    (tmp_path / "hosts.txt").write_text("127.0.0.1  # scheduler and a worker\n127.0.0.1\n")
    with open_cluster(ClusterChoice(ssh=tmp_path / "hosts.txt", memory_gib=0.5)) as client:
        assert client.scheduler.address.startswith("tls://")
        assert client.submit(sum, (2, 3)).result(timeout=30) == 5
        client.wait_for_workers(2)
        told = list(client.run(told_by_worker).values())
        assert len(told) == 2
        for _, folder, modes, seen, spills, _ in told:
            assert Path(folder).name in left() - before
            assert modes == {0o700, 0o600}
            assert spills is False, "settings did not reach the host"
            assert not seen, "a private key is visible in a command line"
        mine = sorted(os.sched_getaffinity(0))
        assert sorted(cores for *_, cores in told) == sorted([mine[0::2], mine[1::2] or mine[:1]])
    assert left() == before, "certificates stay behind"
    commands = (tmp_path / "commands").read_text()
    assert "PRIVATE KEY" not in commands
    assert commands.count("distributed.cli.dask_spec") == 3
    while any(psutil.pid_exists(worker) for worker, *_ in told):  # Ended by the time limit of tests.
        time.sleep(0.05)


def test_a_host_that_does_not_know_us_is_one_line(port, tmp_path):
    before = left()
    (tmp_path / "authorized").write_text(asyncssh.generate_private_key("ssh-ed25519").export_public_key().decode())
    (tmp_path / "hosts.txt").write_text("127.0.0.1\n")
    # Keys are read anew for each connection.
    with pytest.raises(OptionError, match=r"--ssh: 127\.0\.0\.1 does not let us in") as caught:
        with open_cluster(ClusterChoice(ssh=tmp_path / "hosts.txt")):
            pytest.fail("opened")
    assert "\n" not in str(caught.value)
    assert left() == before


def test_a_host_that_is_another_than_before_is_one_line(port, tmp_path):
    other = asyncssh.generate_private_key("ssh-ed25519").export_public_key().decode()
    (tmp_path / "home" / ".ssh" / "known").write_text(f"[127.0.0.1]:{port} {other}")
    (tmp_path / "hosts.txt").write_text("127.0.0.1\n")
    with pytest.raises(OptionError, match=r"does not let us in, .*Host key is not trusted"):
        with open_cluster(ClusterChoice(ssh=tmp_path / "hosts.txt")):
            pytest.fail("opened")


def test_a_host_without_jaxscan_is_one_line(port, tmp_path):
    before = left()
    (tmp_path / "hosts.txt").write_text("127.0.0.1\n")
    with dask.config.set({"jaxscan.python": "/no/python"}):
        with pytest.raises(OptionError, match=r"--ssh: Dask did not start .* for /no/python") as caught:
            with open_cluster(ClusterChoice(ssh=tmp_path / "hosts.txt")):
                pytest.fail("opened")
    assert "\n" not in str(caught.value)
    assert left() == before


def test_a_private_key_in_the_configuration_is_refused(tmp_path):
    (tmp_path / "hosts.txt").write_text("one\n")
    inline = {"distributed.comm.tls.client.key": "-----BEGIN PRIVATE KEY-----\nabc\n"}
    with dask.config.set(inline), pytest.raises(OptionError, match="holds a private key"):
        with open_cluster(ClusterChoice(ssh=tmp_path / "hosts.txt")):
            pytest.fail("opened")


def test_workers_of_one_host_share_it():
    one, two = Host("one"), Host("two", "anna", 2222)
    folders = {one: "/tmp/a", two: "/tmp/b"}
    specs = worker_specs([one, two, one], folders)
    options = [spec["options"] for spec in specs.values()]
    kwargs = [option["kwargs"] for option in options]
    assert [option["address"] for option in options] == ["one", "two", "one"]
    assert [k["memory_limit"] for k in kwargs] == [0.4, 0.8, 0.4]
    assert [k["env"] for k in kwargs] == [{"JAXSCAN_WORKERS": n} for n in "212"]
    assert [k["name"].rpartition("-")[2] for k in kwargs] == ["0", "0", "1"]
    assert len({k["name"] for k in kwargs}) == 3
    assert options[1]["connect_options"] | {"username": "anna", "port": 2222} == options[1]["connect_options"]
    assert "username" not in options[0]["connect_options"]
    assert {k["protocol"] for k in kwargs} == {"tls://"}
    scheduler = scheduler_spec(two, folders)["options"]["kwargs"]
    assert scheduler["security"]["require_encryption"] and scheduler["security"]["tls_ca_file"] == "/tmp/b/ca.pem"
    for node in (scheduler, *kwargs):
        assert "jaxscan.fleet.clusters.no_page" in node["preload"] and node["dashboard"] is False
        assert node["dashboard_address"] == "127.0.0.1:0", "until that is loaded"
