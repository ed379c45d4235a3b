"""Which cluster is meant: contradictions are one line, before anything is started."""

import subprocess
import sys
from pathlib import Path

import pytest

from jaxscan.errors import DependencyError, OptionError
from jaxscan.fleet import ClusterChoice, check_choice, open_cluster
from jaxscan.fleet.clusters import opening
from jaxscan.fleet.clusters.choice import Host, read_hosts


REFUSED = {
    "two kinds": (ClusterChoice(slurm=True, kubernetes=True), "--slurm and --kubernetes: found 2 kinds"),
    "an address too": (ClusterChoice(address="tcp://a:1", slurm=True), "--cluster and --slurm"),
    "no scheme": (ClusterChoice(address="a:1"), "expected tcp://host:port"),
    "no port": (ClusterChoice(address="tcp://a"), "expected tcp://host:port"),
    "a high port": (ClusterChoice(address="tcp://a:65536"), "expected tcp://host:port"),
    "lines": (ClusterChoice(address="tcp://a:1\nb"), "expected tcp://host:port"),
    "in this process": (ClusterChoice(address="inproc://a:1"), "expected tcp://host:port"),
    "tls without an address": (ClusterChoice(tls=Path("folder")), "--tls: goes with --cluster"),
    "tls for tcp": (ClusterChoice(address="tcp://a:1", tls=Path("folder")), "--tls: goes with an address tls://"),
    "no certificates": (ClusterChoice(address="tls://a:1"), "needs --tls FOLDER"),
    "no workers": (ClusterChoice(workers=0), "--workers: found 0, expected 1"),
    "too many": (ClusterChoice(workers=10**9), "--workers: found 1000000000"),
    "no number": (ClusterChoice(memory_gib=float("nan")), "--memory-gib: found nan"),
    "no memory": (ClusterChoice(memory_gib=-1.0), "--memory-gib: found -1"),
    "workers of others": (ClusterChoice(address="tcp://a:1", workers=2), "--workers: does not go with --cluster"),
    "memory of others": (
        ClusterChoice(address="tcp://a:1", memory_gib=2.0),
        "--memory-gib: does not go with",
    ),
}


@pytest.mark.parametrize("name", REFUSED)
def test_a_contradiction_is_one_line_before_any_work(name, monkeypatch):
    choice, says = REFUSED[name]
    monkeypatch.setattr(opening, "_opener", lambda kind: pytest.fail("something was opened"))
    with pytest.raises(OptionError) as caught, open_cluster(choice):
        pytest.fail("opened")
    assert says in str(caught.value)
    assert "\n" not in str(caught.value)


def test_what_can_be_meant_is_not_refused(tmp_path):
    (tmp_path / "hosts.txt").write_text("one\n")
    for choice in (
        ClusterChoice(),
        ClusterChoice(workers=2, memory_gib=4.0),
        ClusterChoice(address="tcp://10.0.0.5:8786"),
        ClusterChoice(address="tls://[fe80::1]:8786", tls=tmp_path),
        ClusterChoice(slurm=True, workers=100, memory_gib=8.0),
        ClusterChoice(kubernetes=True),
        ClusterChoice(ssh=tmp_path / "hosts.txt", memory_gib=8.0),
    ):
        check_choice(choice)


def test_hosts_are_read(tmp_path):
    file = tmp_path / "hosts.txt"
    file.write_text("# the lab\nfast   # two workers\nfast\n\nanna@10.0.0.5:2222\n[fe80::1]:22\r\n")
    fast = Host("fast")
    assert read_hosts(file) == (fast, fast, Host("10.0.0.5", "anna", 2222), Host("fe80::1", None, 22))


HOSTILE = {
    "an option": "-oProxyCommand=reboot\n",
    "a command": "host; reboot\n",
    "a substitution": "$(reboot)\n",
    "a quote": "ho'st\n",
    "two words": "one two\n",
    "a port": "one:0\n",
    "a high port": "one:70000\n",
    "a user only": "anna@\n",
    "an option as a user": "-l@host\n",
    "a letter that looks like another": "hоst\n",
}


@pytest.mark.parametrize("name", HOSTILE)
def test_a_hostile_host_is_one_line(name, tmp_path):
    file = tmp_path / "hosts.txt"
    file.write_text("good\n" + HOSTILE[name])
    with pytest.raises(OptionError, match=r"hosts\.txt: line 2: found .*, expected host") as caught:
        check_choice(ClusterChoice(ssh=file))
    assert "\n" not in str(caught.value)


@pytest.mark.parametrize(
    ("content", "says"),
    [
        (b"", "names no host"),
        (b"# none\n\n", "names no host"),
        (b"\xff\xfe", "is no text"),
        (b"a\n" * 1001, "names 1001 hosts, expected at most 1000"),
        (b"a" * (1 << 19), "larger than"),
    ],
)
def test_an_unfit_file_of_hosts_is_one_line(content, says, tmp_path):
    (tmp_path / "hosts.txt").write_bytes(content)
    with pytest.raises(OptionError, match=says):
        read_hosts(tmp_path / "hosts.txt")


def test_hosts_beside_a_number_of_workers_are_refused(tmp_path):
    (tmp_path / "hosts.txt").write_text("one\n")
    with pytest.raises(OptionError, match="--workers: does not go with --ssh"):
        check_choice(ClusterChoice(ssh=tmp_path / "hosts.txt", workers=2))
    with pytest.raises(OptionError, match=r"missing\.txt"):
        check_choice(ClusterChoice(ssh=tmp_path / "missing.txt"))


@pytest.mark.parametrize(
    ("choice", "module", "says"),
    [
        (ClusterChoice(), "distributed", 'pip install "jaxscan[fleet]"'),
        (ClusterChoice(slurm=True), "dask_jobqueue", 'pip install "jaxscan[fleet]"'),
        (ClusterChoice(kubernetes=True), "dask_kubernetes", 'pip install "jaxscan[kubernetes]"'),
    ],
)
def test_a_missing_package_is_said_with_its_extra(choice, module, says, monkeypatch):
    monkeypatch.setitem(sys.modules, module, None)
    with pytest.raises(DependencyError) as caught, open_cluster(choice):
        pytest.fail("opened")
    assert says in str(caught.value)
    assert "\n" not in str(caught.value)


def test_the_room_is_imported_without_dask():
    """The command line imports it to know its options, also where the extra is not installed."""
    code = "import sys, jaxscan.fleet; print([m for m in ('dask', 'distributed', 'cryptography') if m in sys.modules])"
    run = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)
    assert run.stdout == "[]\n"
