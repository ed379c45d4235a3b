"""`jaxscan init` writes what travels with the package, and never over a file."""

import json
from pathlib import Path

import pytest
from scanrig.config import RigConfig

import jaxscan
from jaxscan.files import load_toml


CONFIGS = Path(jaxscan.__file__).parent / "data" / "configs"
NAMES = sorted(path.name for path in CONFIGS.glob("*.toml"))


def test_every_configuration_is_listed_with_a_line(run):
    assert {"scan.toml", "paper.toml", "unkind.toml"} <= set(NAMES)
    for words in (["init", "--list"], ["init"]):
        ran = run(*words)
        lines = ran.out.splitlines()
        assert ran.code == 0 and [line.split()[0] for line in lines] == NAMES
        assert all(line.endswith(".") and len(line.split()) > 5 for line in lines), lines
    listed = json.loads(run("init", "--list", "--json", "-").out)
    assert sorted(listed["configurations"]) == NAMES and listed["written"] is None


@pytest.mark.parametrize(("name", "load"), [("scan", load_toml), ("paper.toml", None)])
def test_a_configuration_is_written_and_loads(name, load, run, tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    assert run("init", name).code == 0
    (path,) = tmp_path.iterdir()
    assert path.read_bytes() == (CONFIGS / path.name).read_bytes()
    assert load(path, RigConfig) if load else jaxscan.load_simulation(path)


def test_a_file_of_mine_stays(run, refused, tmp_path):
    mine = tmp_path / "mine.toml"
    assert run("init", "desk", "-o", mine).code == 0
    mine.write_text("mine")
    assert "exists" in refused("init", "desk", "-o", mine)
    (tmp_path / "link.toml").symlink_to(tmp_path / "nowhere")
    assert "exists" in refused("init", "desk", "-o", tmp_path / "link.toml")
    assert mine.read_text() == "mine" and not (tmp_path / "nowhere").exists()


def test_the_closest_name_is_said(refused):
    assert '"reference.toml"' in refused("init", "refrence.toml")
    for name in ("../pyproject", "", "/etc/hostname"):
        assert "expected a configuration" in refused("init", name)
