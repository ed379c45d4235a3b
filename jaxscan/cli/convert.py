"""`jaxscan convert`: one cloud format to another."""

from pathlib import Path
from typing import Annotated

import numpy as np
import tyro

from jaxscan import api
from jaxscan.cli.options import CloudPath
from jaxscan.cli.output import JsonTarget, check_json, console, emit_json
from jaxscan.files.clouds import check_cloud_path


def convert(
    source: CloudPath,
    target: Annotated[Path, tyro.conf.Positional, tyro.conf.arg(metavar="OUTPUT")],
    /,
    *,
    json: JsonTarget = None,
) -> None:
    """Convert a cloud: `jaxscan convert room.ply room.e57`.

    Args:
        source: Cloud to read (.ply or .npz).
        target: Cloud to write; the suffix chooses the format (.ply .e57 .laz .las .pcd .xyz .ptx .npz).
        json: Write the result as JSON too.
    """
    check_cloud_path(target)
    check_json(json)
    cloud = api.load_cloud(source)
    api.save_cloud(cloud, target)
    points = int(np.asarray(cloud.valid).sum())
    console(json).print(f"written: {target} ({points} points)")
    emit_json(json, "convert", {"source": str(source), "cloud": str(target), "points": points})
