"""The file of what is known of a room: lengths, and where the rig stood."""

import re

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


def test_known_lengths_are_read(tmp_path):
    (tmp_path / "known.toml").write_text(
        "[[length]]\nmetres = 3.9\nsigma_mm = 0.5\na = [1, 2.5, 0]\nb = [-2.9, 2.5, 0]\n"
        '[[length]]\nmetres = 0.08\nsigma_mm = 0.1\na = "board corner 1"\nb = "marker 7 corner 2"\n'
    )
    given = load_known_room(tmp_path / "known.toml")
    assert given.stations is None
    walls, targets = given.lengths
    assert (walls.metres, walls.sigma_m) == (3.9, 0.0005)
    np.testing.assert_array_equal([walls.first, walls.second], [[1, 2.5, 0], [-2.9, 2.5, 0]])
    assert (targets.first, targets.second) == ("board corner 1", "marker 7 corner 2")


@pytest.mark.parametrize(
    ("text", "named"),
    [
        ("", "found nothing, expected [[length]] or [[station]]"),
        ("[[length", "not valid TOML"),
        ("[[length]]\nmetre = 1", "unknown key"),
        ("[[length]]\nmetres = 1.0\nsigma_mm = 0.5\na = [0, 0]\nb = [1, 0, 0]", "length[0].a: expected three"),
        ("[[length]]\nmetres = 1.0\nsigma_mm = 0.5\na = [0, 0, 0]\nb = [0, 0, 0]", "the same place"),
        ('[[length]]\nmetres = 1.0\nsigma_mm = 0.5\na = [0, 0, 0]\nb = "marker 7 corner 2"', "two of one kind"),
        ("[[length]]\nmetres = -1.0\nsigma_mm = 0.5\na = [0, 0, 0]\nb = [1, 0, 0]", "length[0].metres: found -1"),
        ("[[length]]\nmetres = 1.0\nsigma_mm = 0\na = [0, 0, 0]\nb = [1, 0, 0]", "length[0].sigma_mm: found 0"),
        ("[[station]]\nat = [1, 0, 1e9]\nyaw_deg = 3", "station[0].at[2]: found 1000000000.0"),
        ("[[station]]\nat = [1, 0, 0]\nyaw_deg = inf", "station[0].yaw_deg: found Infinity"),
        ("[[station]]\nat = [1, 0, 0]", "station[0].yaw_deg"),
        ("[[station]]\nat = [1, 0]\nyaw_deg = 3", "station[0].at"),
        ("[[station]]\nat = [1, 0, 0]\nyaw_deg = 400", "station[0].yaw_deg: found 400"),
        ("#" * (1 << 20) + "\n", "larger than"),
    ],
)
def test_a_wrong_file_is_one_line(tmp_path, text, named):
    (tmp_path / "known.toml").write_text(text)
    with pytest.raises(ConfigError, match=re.escape(named)) as caught:
        load_known_room(tmp_path / "known.toml")
    assert str(caught.value).startswith(f"{tmp_path / 'known.toml'}: ") and "\n" not in str(caught.value)
