"""Where the rig stood, in the file of a room's known lengths."""

import numpy as np
import pytest

from jaxscan.errors import ConfigError
from jaxscan.files.known_room import load_known_room


def test_places_of_stations_are_read(tmp_path):
    path = tmp_path / "known.toml"
    path.write_text("[[station]]\nat = [2.0, 0.5, 0.1]\nyaw_deg = 90\n[[station]]\nat = [0, 1, 0]\nyaw_deg = -180\n")
    poses = load_known_room(path).stations
    assert poses.shape == (3, 4, 4) and np.array_equal(poses[0], np.eye(4))
    # Ahead of the second station is the y of the first.
    np.testing.assert_allclose(poses[1] @ [1, 0, 0, 1], [2.0, 1.5, 0.1, 1], rtol=0, atol=1e-15)
    np.testing.assert_allclose(poses[2] @ [1, 0, 0, 1], [-1, 1, 0, 1], rtol=0, atol=1e-15)
    path.write_text("[[sphere]]\ndiameter_mm = 100\nat = [1, 0, 0]\n")
    assert load_known_room(path).stations is None


@pytest.mark.parametrize(
    ("text", "named"),
    [
        ("[[station]]\nat = [1, 0, 0]", r"station\[0\].yaw_deg"),
        ("[[station]]\nat = [1, 0]\nyaw_deg = 3", r"station\[0\].at"),
        ("[[station]]\nat = [1, 0, 0]\nyaw_deg = 400", r"station\[0\].yaw_deg: found 400"),
    ],
)
def test_wrong_places_are_refused(tmp_path, text, named):
    (tmp_path / "known.toml").write_text(text)
    with pytest.raises(ConfigError, match=named):
        load_known_room(tmp_path / "known.toml")
