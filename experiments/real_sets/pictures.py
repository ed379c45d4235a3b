"""Captures as NumPy and OpenCV see them, without jaxscan."""

import json
import tomllib
from pathlib import Path
from typing import Any

import cv2
import numpy as np


class Pictures:
    """Header, records and pictures of a capture."""

    def __init__(self, folder: Path) -> None:
        """Read header and journal."""
        self.folder = folder
        self.header: dict[str, Any] = tomllib.loads((folder / "capture.toml").read_text())
        lines = (folder / "frames.jsonl").read_text().splitlines()
        self.records: list[dict[str, Any]] = [json.loads(line) for line in lines]
        camera = self.header["camera"]
        self.size = (int(camera["width"]), int(camera["height"]))

    @property
    def lasers(self) -> list[dict[str, Any]]:
        """The tables of the lasers."""
        return list(self.header.get("laser", []))

    def rgb(self, path: str) -> np.ndarray:
        """uint8 [rows, columns, 3]."""
        return cv2.cvtColor(cv2.imread(str(self.folder / path), cv2.IMREAD_COLOR), cv2.COLOR_BGR2RGB)

    def grey(self, record: dict[str, Any]) -> np.ndarray:
        """The picture of a record that shows its board best: with the laser off, if there is one."""
        return cv2.imread(str(self.folder / (record["off"] or record["on"])), cv2.IMREAD_GRAYSCALE)
