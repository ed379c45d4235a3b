"""Arguments that several verbs share."""

from pathlib import Path
from typing import Annotated

import tyro


CapturePath = Annotated[Path, tyro.conf.Positional, tyro.conf.arg(metavar="CAPTURE")]
CloudPath = Annotated[Path, tyro.conf.Positional, tyro.conf.arg(metavar="CLOUD")]
OutputPath = Annotated[Path, tyro.conf.arg(aliases=["-o"])]
CalibrationPath = Annotated[Path, tyro.conf.arg(aliases=["-c"])]
