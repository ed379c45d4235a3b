"""Makes a capture of a stranger's pictures; neither they nor the capture belong to this project.

    python -m experiments.real_sets.convert NAME FOLDER -o captures/NAME

FOLDER is a copy of the repository, or a bare git snapshot of it. Pictures are copied as they are. A board's picture
without a laser becomes a record's `off`, one with the laser on its `on`.
"""

import json
import shutil
from pathlib import Path

import cv2
import numpy as np
import tomli_w

import jaxscan
from experiments.real_sets.sets import BY_NAME, RealSet, Source
from experiments.report import command_line


def convert(one: RealSet, source: Source, folder: Path) -> int:
    """Write the capture.

    Args:
        folder: The capture's folder; must not exist.

    Returns:
        Number of records.
    """
    records = one.records(source)
    if not records:
        raise SystemExit(f"{source.place}: no pictures of {one.name} found, expected a copy of {one.repository}")
    folder.mkdir(parents=True)
    size: dict[str, int] = {}
    lines = []
    for k, record in enumerate(records):
        written = {"i": k, **record}
        for which in ("on", "off"):
            path = record[which]
            if path is None:
                continue
            data = source.read(path)
            # The size of the first picture; a picture of another size is refused by whoever reads the capture.
            size = size or _size(data)
            name = f"{which}/{k:06d}{Path(path).suffix}"
            (folder / which).mkdir(exist_ok=True)
            (folder / name).write_bytes(data)
            written[which] = name
        lines.append(json.dumps(written))
    (folder / "frames.jsonl").write_text("\n".join(lines) + "\n")
    camera = {**size, **one.header["camera"]}
    origin = {
        "repository": one.repository,
        "commit": one.commit,
        "licence": one.licence,
        "about": one.about,
    }
    header = {"format": "jaxscan-capture/1", **one.header, "camera": camera, "acquisition": origin}
    (folder / "capture.toml").write_text(tomli_w.dumps(header))
    return len(records)


def _size(data: bytes) -> dict[str, int]:
    picture = cv2.imdecode(np.frombuffer(data, np.uint8), cv2.IMREAD_UNCHANGED)
    return {"width": picture.shape[1], "height": picture.shape[0]}


def main() -> int:
    """Convert one set."""
    parser = command_line(__doc__)
    parser.add_argument("name", choices=sorted(BY_NAME))
    parser.add_argument("folder", type=Path)
    parser.add_argument("-o", "--output", type=Path, required=True)
    options = parser.parse_args()
    partial = options.output.with_name(f"{options.output.name}.partial")
    shutil.rmtree(partial, ignore_errors=True)
    count = convert(BY_NAME[options.name], Source(options.folder), partial)
    partial.rename(options.output)
    try:
        jaxscan.open_capture(options.output)
    except jaxscan.JaxscanError as problem:
        print(f"note: {problem}")
    print(f"{options.output}: {count} records of {options.name}")
    return 0


if __name__ == "__main__":
    raise SystemExit(main())
