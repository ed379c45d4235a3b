"""What `jaxscan doctor` says of this machine."""

import json
import sys


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
