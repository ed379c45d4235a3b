"""Structured cases of bad luck and bad will through every verb: one line each, and nothing else happens."""

from pathlib import Path

import pytest

from .cases import make_case
from .corpus import make_corpus
from .farm import ROOT, run_cases
from .judge import snapshot, verdict


@pytest.fixture(scope="session")
def corpus(tiny, tmp_path_factory):
    folder = tmp_path_factory.mktemp("fuzz") / "corpus"
    make_corpus(tiny.folder, folder, ROOT / "configs")
    return folder


def told(answers):
    """The cases with faults, so that each can be run again: `python -m tests.fuzz --seed S --first N --cases 1`."""
    return [
        f"{one['seed']} {one['number']}: {one['kind']}: {one['faults']} {one.get('left')} {one.get('err', '')[-300:]}"
        for one in answers
        if one["faults"]
    ]


@pytest.mark.parametrize("numbers", [range(4), pytest.param(range(4, 150), marks=pytest.mark.more)], ids=str)
def test_few_cases(corpus, numbers):
    answers = run_cases([(0, number) for number in numbers], corpus, processes=1)
    assert len(answers) == len(numbers)
    assert told(answers) == []


PARTS, CASES = 10, 1000
"""Of each seed. A part stands alone, `-k "many_cases and 3-7"`; `--last-failed` goes on where a run ended."""


@pytest.mark.slow
@pytest.mark.timeout(1200)
@pytest.mark.parametrize("part", range(PARTS))
@pytest.mark.parametrize("seed", range(1, 6))
def test_many_cases(corpus, seed, part):
    numbers = range(part * CASES, (part + 1) * CASES)
    answers = run_cases([(seed, number) for number in numbers], corpus, processes=1)
    assert len(answers) == CASES
    assert told(answers) == []


def test_a_case_is_the_same_every_time(corpus, tmp_path):
    """A fault that was found can be looked at again."""
    for number in range(40):
        one, other = (make_case(7, number, corpus, tmp_path / f"{number}{name}") for name in "ab")
        assert one.kind == other.kind
        first, second = (snapshot(tmp_path / f"{number}{name}") for name in "ab")
        # Links name the folder that they are in, and archives hold the time.
        assert first.keys() == second.keys()


class TestVerdict:
    """The judge finds each fault; otherwise a run without faults would prove nothing."""

    ERROR = b"jaxscan: a.ply: no such file.\n"

    @pytest.mark.parametrize(
        ("fault", "change"),
        [
            ("traceback", {"code": None}),
            ("traceback", {"code": 70}),
            ("traceback", {"code": -11}),
            ("traceback", {"err": b"Traceback (most recent call last):\n  ...\n"}),
            ("hang", {"seconds": 31.0}),
            ("memory", {"peak": 1_600_000_000}),
            ("terminal", {"err": b"jaxscan: \x1b[31m\n"}),
            ("terminal", {"out": "\x9b31m\n".encode()}),
            ("terminal", {"out": b"\xff\n"}),
            ("terminal", {"out": "\u202e\n".encode()}),
            ("lines", {"err": b"libpng error: bad CRC\n" + ERROR}),
            ("lines", {"err": b""}),
            ("lines", {"code": 0}),
        ],
    )
    def test_finds(self, fault, change):
        good = {"code": 1, "out": b"", "err": self.ERROR, "seconds": 0.1, "peak": 10**8}
        assert verdict(**good) == []
        assert fault in verdict(**(good | change))

    def test_finds_changed_inputs(self, tmp_path):
        (tmp_path / "in").mkdir()
        (tmp_path / "in" / "a").write_text("1")
        before = snapshot(tmp_path)
        Path(tmp_path / "in" / "a").write_text("2")
        (tmp_path / ".part-1").touch()
        assert snapshot(tmp_path) != before
