"""`python -m tests.fuzz --cases 10000 --seed 1`: cases at length, with a table of their faults.

A case is a number of a seed: `--first 4711 --cases 1` runs one of them again. `--corpus FOLDER` keeps the files from
which cases are made, and beside them what was compiled, so that the next run begins at once; a folder that is there
already is used as it is. `--faults FILE` gets a line of JSON for each case with a fault, while the run goes on. The
exit code is 1 where there was one. The slow tests run the seeds 1 to 5 in parts of 1000 cases.
"""

import argparse
import json
import sys
import tempfile
import time
from pathlib import Path

from .farm import ROOT, counts, run_cases


def main() -> int:
    parser = argparse.ArgumentParser(
        prog="python -m tests.fuzz", description=__doc__.splitlines()[0] if __doc__ else None
    )
    parser.add_argument("--cases", type=int, default=10_000)
    parser.add_argument("--first", type=int, default=0, help="number of the first case")
    parser.add_argument("--seed", type=int, default=1)
    parser.add_argument("--processes", type=int, default=2)
    parser.add_argument("--corpus", type=Path, help="folder that an earlier run made; made anew if not there")
    parser.add_argument("--faults", type=Path, help="file for the cases with faults, a line of JSON each")
    parser.add_argument("--all", action="store_true", help="note every case in that file, not only those with faults")
    chosen = parser.parse_args()
    corpus = chosen.corpus or Path(tempfile.mkdtemp(prefix="jaxscan-corpus-")) / "corpus"
    if not corpus.is_dir():
        build(corpus)
    start, done = time.monotonic(), 0
    log = None if chosen.faults is None else open(chosen.faults, "a")

    def tell(answer: dict) -> None:
        nonlocal done
        done += 1
        silent = answer.get("differs") and not answer["noted"]
        if log is not None and (chosen.all or answer["faults"] or silent):
            log.write(json.dumps(answer) + "\n")
            log.flush()
        if done % 500 == 0:
            print(f"{done} cases in {time.monotonic() - start:.0f} s", file=sys.stderr, flush=True)

    cases = [(chosen.seed, number) for number in range(chosen.first, chosen.first + chosen.cases)]
    answers = run_cases(cases, corpus, processes=chosen.processes, tell=tell)
    for name, count in sorted(counts(answers).items()):
        print(f"{count:8d}  {name}")
    for name in ("seconds", "peak"):
        worst = max(answers, key=lambda answer: answer.get(name) or 0)
        print(f"largest {name}: {worst.get(name)} in case {worst['seed']} {worst['number']} ({worst['kind']})")
    return int(any(answer["faults"] for answer in answers))


def build(corpus: Path) -> None:
    """Make the corpus in a process of its own, so that this one stays small."""
    import subprocess

    program = (
        "from pathlib import Path; import sys; from tests.conftest import go_the_whole_way; "
        "from tests.fuzz.corpus import make_corpus; tiny, corpus, configs = map(Path, sys.argv[1:]); "
        "tiny.mkdir(parents=True); go_the_whole_way(tiny); make_corpus(tiny, corpus, configs)"
    )
    tiny = corpus.with_name(corpus.name + "-rig")
    words = [sys.executable, "-c", program, str(tiny), str(corpus), str(ROOT / "configs")]
    subprocess.run(words, cwd=ROOT, check=True)


if __name__ == "__main__":
    sys.exit(main())
