"""The report of a reconstruction: its numbers are those of the cloud, and it stands alone."""

import dataclasses

import numpy as np
import pytest

from jaxscan.errors import CloudError
from jaxscan.report import Beside, cloud_page, facts_of
from jaxscan.report.clouds.facts import directions_of

from .made_room import ELEVATION, made_room, only
from .test_calibration_page import HOSTILE, Document


@pytest.fixture(scope="module")
def document(cloud, box):
    return Document(cloud_page(facts_of(cloud, box), box, Beside(name=HOSTILE, notes=(HOSTILE,), doubts=(HOSTILE,))))


def test_it_has_its_sections_and_asks_for_nothing(document):
    assert document.words["h2"] == [
        "Dimensions",
        "Coverage",
        "Uncertainty",
        "Reflections left out",
        "Suspicious steps",
        "Calibration",
    ]
    assert not {"script", "iframe", "object", "link", "base", "form"} & set(document.tags)
    for tag, key, value in document.attributes:
        assert not key.startswith("on"), (tag, key)
        if key.endswith("href") or key in ("src", "srcset"):
            assert value.startswith(("#", "data:image/png;base64,", "data:image/jpeg;base64,")), (tag, key)
    assert "<script>alert(1)</script>" in document.all_words()
    # One picture for desks, and one with larger words for telephones.
    assert document.tags.count("source") == document.tags.count("img") == 1


def test_dimensions_are_those_of_measure_room(document, box):
    for side in (box.length, box.width, box.height):
        assert f"{side.value_m:.4f} m ± {1e3 * side.sigma_m:.2f} mm" in document.words["td"]


def test_the_band_and_a_hole_are_found(cloud):
    """Rays between -50 and 50 degrees of elevation; then none in a window of 40 by 20 degrees."""
    (seen,) = facts_of(cloud).directions
    # At the very rim of the band cells are half full.
    assert seen.share(of_band=True) > 0.97
    assert seen.share(of_band=False) == pytest.approx(np.sin(np.radians(ELEVATION)), abs=0.03)
    azimuth, elevation = (np.degrees(angle) for angle in angles(cloud.xyz))
    window = (np.abs(azimuth - 60.0) < 20.0) & (np.abs(elevation - 10.0) < 10.0)
    (seen,) = facts_of(only(cloud, cloud.valid & ~window)).directions
    largest = seen.holes()[0]
    assert largest.azimuth_deg == pytest.approx(60.0, abs=seen.side_deg)
    assert largest.elevation_deg == pytest.approx(10.0, abs=seen.side_deg)
    assert largest.wide_deg == pytest.approx(40.0, abs=2 * seen.side_deg)
    assert largest.high_deg == pytest.approx(20.0, abs=2 * seen.side_deg)


def angles(xyz):
    return np.arctan2(xyz[..., 1], xyz[..., 0]), np.arctan2(xyz[..., 2], np.hypot(xyz[..., 0], xyz[..., 1]))


def test_sigmas_by_distance(cloud):
    far = np.linalg.norm(cloud.xyz, axis=-1)
    facts = facts_of(dataclasses.replace(cloud, sigma_random=(1e-3 * far).astype(np.float32)))
    assert sum(row.points for row in facts.sigma) == facts.points == far.size
    for row in facts.sigma:
        mine = far[(far >= row.nearest_m) & (far < row.farthest_m)]
        assert row.points == len(mine)
        assert row.median_m == pytest.approx(1e-3 * np.median(mine), rel=1e-5)


def test_points_beyond_the_walls_are_counted(cloud, box):
    moved = cloud.xyz.copy()
    moved[5, 40:50] *= 2.0
    assert facts_of(cloud, box).beyond_walls == 0
    assert facts_of(dataclasses.replace(cloud, xyz=moved), box).beyond_walls == 10


def test_a_profile_that_is_elsewhere_is_suspicious(cloud):
    assert facts_of(cloud).doubts == ()
    moved = cloud.xyz.copy()
    moved[70] *= 1.5
    (doubt,) = facts_of(dataclasses.replace(cloud, xyz=moved)).doubts
    assert "record 70" in doubt


def test_what_a_foreign_cloud_lacks_is_said(cloud, box, monkeypatch):
    monkeypatch.setattr("jaxscan.report.drawing.as_svg", lambda figure, name, description: "")
    bare = dataclasses.replace(cloud, angle=np.zeros(len(cloud.angle)), sigma_random=0 * cloud.sigma_random)
    words = Document(cloud_page(facts_of(bare), None, Beside(name="room.las", no_dimensions="No walls."))).all_words()
    for said in (
        "None: No walls.",
        "The cloud holds no standard deviations",
        "does not say at which angles",
        "Not known: the cloud does not name it",
    ):
        assert said in words


def test_nothing_is_no_report(cloud):
    with pytest.raises(CloudError, match="no valid points"):
        facts_of(only(cloud, np.zeros_like(cloud.valid)))


def test_strays_and_single_points():
    """A point 1e30 m away is not drawn; one direction alone has a share of next to nothing."""
    far = made_room(grid=(40, 30))
    xyz = far.xyz.copy()
    xyz[3, 4] = 1e30
    facts = facts_of(dataclasses.replace(far, xyz=xyz))
    assert facts.far_off == 1 and not facts.shown.valid[3, 4]
    one = directions_of(np.array([[1.0, 0.0, 0.0]]), np.array([0.0]))
    assert (
        one.count.sum() == 1
        and np.isnan(one.sigma_m).all()
        and one.share(of_band=True) > 0
        and one.share(of_band=False) == 0
    )
