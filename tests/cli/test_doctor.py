"""`jaxscan doctor` on this machine and on captures."""

import json
import sys
import tomllib
from pathlib import Path

from jaxscan.cli.doctor import OPTIONAL

from ..hardware.desk import Desk


def checks(ran):
    result = json.loads(ran.out)
    assert result["format"] == "jaxscan-doctor/1"
    return {check["name"]: check for check in result["checks"]}


def test_what_is_installed_works(run):
    ran = run("doctor", "--json", "-")
    assert ran.code == 0, ran.err
    found = checks(ran)
    for name in ("JAX", "OpenCV", "optimistix", "matplotlib (reports)"):
        assert found[name]["works"] and found[name]["detail"][0].isdigit(), found[name]


def test_what_is_missing_is_said(run, monkeypatch):
    monkeypatch.setitem(sys.modules, "matplotlib.figure", None)
    ran = run("doctor", "--json", "-")
    # Only reports need it.
    assert ran.code == 0, ran.err
    assert not checks(ran)["matplotlib (reports)"]["works"]
    monkeypatch.setitem(sys.modules, "cv2", None)
    ran = run("doctor", "--json", "-")
    assert ran.code == 1
    assert ran.err.endswith("\njaxscan: OpenCV must work and does not: see the table.\n")
    assert not checks(ran)["OpenCV"]["works"]


def test_what_optional_packages_are_for(run, monkeypatch):
    for module in ("ezdxf", "ifcopenshell", "pye57", "aiohttp"):
        monkeypatch.setitem(sys.modules, module, None)
    ran = run("doctor", "--json", "-")
    assert ran.code == 0, ran.err
    found = checks(ran)
    for name, without, extra in (
        ("ezdxf", "drawings as DXF", "plan"),
        ("ifcopenshell", "rooms as IFC", "ifc"),
        ("pye57", "clouds written as E57", "export"),
        ("aiohttp", "console, view", "console"),
    ):
        assert found[name] | {"detail": ""} == {
            **{"name": name, "needed": False, "works": False, "detail": "", "without": without, "extra": extra}
        }
        assert f"{name}: import of {name.removesuffix('-sdk')} halted" in ran.err and without in ran.err
    assert found["open3d"]["works"] and found["open3d"]["detail"][0].isdigit()
    assert 'to have them all: pip install "jaxscan[console,export,plan,ifc]"' in ran.err


def test_every_optional_package_is_brought_by_its_extra():
    tables = tomllib.loads((Path(__file__).resolve().parents[2] / "pyproject.toml").read_text())
    extras = tables["project"]["optional-dependencies"]
    for package, (_, extra, _) in OPTIONAL.items():
        assert package in " ".join(extras[extra])


def test_ports_and_cameras_are_listed(run):
    result = json.loads(run("doctor", "--json", "-").out)
    assert isinstance(result["ports"], list) and isinstance(result["cameras"], list)


def test_a_capture_is_verified(run, sweep):
    assert run("doctor", "--capture", sweep).code == 0
    victim = sorted((sweep / "on").iterdir())[3]
    victim.unlink()
    ran = run("doctor", "--capture", sweep, "--json", "-")
    assert ran.code == 1 and "1 problems" in ran.err.splitlines()[-1]
    (problem,) = json.loads(ran.out)["problems"]
    assert victim.name in problem


def test_of_many_problems_some_are_printed_and_all_are_in_the_json(run, sweep):
    journal = sweep / "frames.jsonl"
    first = json.loads(journal.read_text().splitlines()[0])
    lines = [json.dumps(first | {"i": k, "on": "on/gone.zst"}) for k in range(150)]
    journal.write_text("\n".join(lines) + "\n")
    ran = run("doctor", "--capture", sweep)
    assert ran.code == 1 and ran.out.count("gone.zst") == 100 and "and 50 more problems" in ran.out
    ran = run("doctor", "--capture", sweep, "--json", "-")
    assert len(json.loads(ran.out)["problems"]) == 150


def test_a_broken_seal_is_not_cured_by_taking_records_again(run, tmp_path):
    assert Desk().sweep(tmp_path / "room").status == "complete"
    journal = tmp_path / "room" / "frames.jsonl"
    journal.write_text(journal.read_text().replace('"angle_deg": 3.6', '"angle_deg": 3.7'))
    ran = run("doctor", "--capture", tmp_path / "room")
    last = ran.err.splitlines()[-1]
    assert ran.code == 1 and "the seal does not fit" in ran.out
    assert "1 problems; the journal or the header has changed since it was written" in last and "--resume" not in last
    # --resume repairs a torn last line and a missing image.
    with open(journal, "a") as file:
        file.write('{"event": "ta')
    next((tmp_path / "room" / "on").iterdir()).unlink()
    last = run("doctor", "--capture", tmp_path / "room").err.splitlines()[-1]
    assert "3 problems" in last and "--resume" in last and "the journal or the header has changed" in last


def test_options_that_do_not_go_together(refused):
    assert "--camera: found without --config" in refused("doctor", "--camera", "0")
