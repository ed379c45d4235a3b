"""Draws how far the walls of a room are from flat before and after a recalibration: docs/recalibration.png.

The laser of the rig of `configs/paper.toml` is turned by 0.05 degrees after a good calibration.

    python -m experiments.recalibration.panorama [SEED]
"""

import sys
from pathlib import Path

from experiments.recalibration.kinds import KINDS
from experiments.recalibration.trial import run
from jaxscan.report.recalibration import drift_words, plots


PICTURE = Path(__file__).resolve().parents[2] / "docs" / "recalibration.png"


def main() -> int:
    """The command."""
    seed = int(sys.argv[1]) if len(sys.argv) > 1 else 1
    figures, result = run(KINDS["laser turned"](seed))
    if result is None:
        print(figures["problem"])
        return 1
    plots.panorama_figure(*plots.panorama_rows(result.panoramas[0])).savefig(PICTURE, dpi=90)
    print(drift_words(result.drift))
    return 0


if __name__ == "__main__":
    sys.exit(main())
