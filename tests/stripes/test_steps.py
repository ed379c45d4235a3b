"""What neighbouring steps know: reflections are put right, real edges are left alone."""

import numpy as np
import pytest

from jaxscan.stripes.choose import check_steps


PROFILES, LINES = 90, 64


def surface(profiles=PROFILES, seed=0):
    """A wall that bends: the stripe moves by up to 3 px from step to step [profiles, lines]."""
    p, line = np.arange(profiles)[:, None], np.arange(LINES)
    rng = np.random.default_rng(seed)
    return 500 + 80 * np.sin(p / 25) + 40 * np.cos(line / 30) + rng.normal(0, 0.1, (profiles, LINES))


def candidates(*centres):
    """u and exists [profiles, lines, 3] of one to three planes; NaN where there is no candidate."""
    missing = np.full(centres[0].shape, np.nan)
    u = np.stack([*centres, *[missing] * (3 - len(centres))], -1).astype(np.float32)
    return np.nan_to_num(u), np.isfinite(u)


def check(u, exists, chosen):
    return np.asarray(check_steps(u, exists, np.asarray(chosen, np.int8)))


def reflections(seed=1, share=0.2):
    """Which entries a reflection won: single ones, and runs of lines within one profile."""
    rng = np.random.default_rng(seed)
    wrong = rng.random((PROFILES, LINES)) < 0.5 * share
    for profile in rng.permutation(PROFILES)[: PROFILES // 5]:
        start = rng.integers(0, LINES // 2)
        wrong[profile, start : start + LINES // 2] = True
    return wrong, rng


def test_reflections_give_way_to_the_surface():
    true = surface()
    wrong, rng = reflections()
    assert 0.18 < np.mean(wrong) < 0.25
    # Within a run a reflection is as smooth along the lines as a surface.
    ghost = rng.uniform(100, 1100, (PROFILES, 1)) + 0.5 * np.arange(LINES) + np.where(wrong, 0, rng.uniform(0, 50))
    u, exists = candidates(
        true, ghost, np.where(rng.random(true.shape) < 0.3, rng.uniform(0, 1200, true.shape), np.nan)
    )
    found = check(u, exists, np.where(wrong, 1, 0))
    assert np.mean(found[wrong] == 0) > 0.98
    # What was right stays, but for the odd ghost that lies on the track itself.
    assert np.mean(found[~wrong] == 0) > 0.998


def test_reflections_that_hide_the_surface_are_dropped():
    true = surface()
    wrong, rng = reflections(share=0.1)
    ghost = rng.uniform(100, 1100, (PROFILES, 1)) + 0.5 * np.arange(LINES)
    u, exists = candidates(np.where(wrong, ghost, true))
    found = check(u, exists, np.zeros(true.shape))
    # The evidence: on either side at least two of the three neighbours show the surface.
    padded = np.pad(~wrong, ((3, 3), (0, 0)))
    shifted = lambda offset: padded[3 + offset :][:PROFILES].astype(int)
    before, after = (sum(shifted(side * distance) for distance in (1, 2, 3)) for side in (-1, 1))
    told = wrong & (before >= 2) & (after >= 2)
    assert np.count_nonzero(told) > 0.7 * np.count_nonzero(wrong)
    assert np.mean(found[told] == -1) > 0.98
    assert np.mean(found[~wrong] == 0) > 0.998


def test_a_cable_stays_and_a_thread_does_not():
    true = surface()
    true[40:42] -= 60.0
    true[60] += 30.0
    u, exists = candidates(true)
    expected = np.zeros(true.shape)
    expected[60] = -1
    np.testing.assert_array_equal(check(u, exists, np.zeros(true.shape)), expected)


def test_depth_edges_stay():
    # Walls of a few steps each, far apart, in every line elsewhere: each end has one-sided support.
    rng = np.random.default_rng(2)
    p, line = np.arange(PROFILES)[:, None], np.arange(LINES)
    for length in (3, 5, 12):
        wall = (p + 7 * line) // length
        true = rng.uniform(100, 1100, wall.max() + 1)[wall] + 2.0 * p + rng.normal(0, 0.1, wall.shape)
        ghost = rng.uniform(0, 1200, true.shape)
        found = check(*candidates(true, ghost), np.zeros(true.shape))
        assert not np.any(found == -1)
        assert np.mean(found == 0) > 0.995


def test_an_edge_between_two_surfaces_keeps_what_lies_between():
    # A mixed pixel at the edge has no support, but the two sides do not agree either.
    true = np.full((PROFILES, LINES), 300.0)
    true[40:] = 700.0
    true[40] = 520.0
    np.testing.assert_array_equal(check(*candidates(true), np.zeros(true.shape)), 0)


@pytest.mark.parametrize("profile", [0, 1, PROFILES - 2, PROFILES - 1])
def test_the_ends_of_a_sweep(profile):
    true = surface()
    chosen = np.zeros(true.shape, np.int8)
    chosen[profile] = 1
    ghost = true + 200.0 * (-1.0) ** np.arange(PROFILES)[:, None]
    # With the surface among the candidates it is chosen; without, nothing says that the first profile errs.
    np.testing.assert_array_equal(check(*candidates(true, ghost), chosen), 0)
    alone = true.copy()
    alone[profile] = ghost[profile]
    found = check(*candidates(alone), np.zeros(true.shape))
    if profile in (0, PROFILES - 1):
        np.testing.assert_array_equal(found, 0)
    np.testing.assert_array_equal(np.delete(found, profile, 0), 0)


@pytest.mark.more
@pytest.mark.parametrize("profiles", [1, 2])
def test_few_profiles_are_left_alone(profiles):
    rng = np.random.default_rng(3)
    u, exists = candidates(*rng.uniform(0, 1000, (3, profiles, LINES)))
    chosen = rng.integers(-1, 3, (profiles, LINES)).astype(np.int8)
    found = check(u, exists, chosen)
    np.testing.assert_array_equal(found, chosen)
    assert found.dtype == np.int8


def test_isolated_profiles_and_lines_without_a_choice():
    true = surface()
    chosen = np.full(true.shape, -1, np.int8)
    chosen[::10] = 1
    found = check(*candidates(true, true + 100.0), chosen)
    np.testing.assert_array_equal(found, chosen)
    chosen = np.zeros(true.shape, np.int8)
    chosen[40, ::2] = -1
    np.testing.assert_array_equal(check(*candidates(true), chosen), chosen)


def test_coarse_steps_are_no_evidence():
    # The stripe moves so far and so unevenly that no three centres are in line.
    u, exists = candidates(*np.random.default_rng(4).uniform(0, 1200, (2, PROFILES, LINES)))
    found = check(u, exists, np.zeros((PROFILES, LINES)))
    assert np.mean(found != 0) < 0.002


def test_a_track_steeper_than_allowed_is_none():
    chosen = np.zeros((PROFILES, LINES), np.int8)
    chosen[45] = 1
    for slope, expected in ((35.0, 0), (45.0, chosen)):
        true = 100.0 + slope * np.arange(PROFILES)[:, None] + np.zeros(LINES)
        np.testing.assert_array_equal(check(*candidates(true, true + 90.0), chosen), expected)


def test_the_result_does_not_depend_on_the_blocks():
    true = surface(80)
    rng = np.random.default_rng(5)
    u, exists = candidates(true, rng.uniform(0, 1200, true.shape))
    chosen = (rng.random(true.shape) < 0.2).astype(np.int8)
    whole = check(u, exists, chosen)
    for start in range(0, 60, 7):
        part = check(u[start : start + 20], exists[start : start + 20], chosen[start : start + 20])
        # Two passes, each of which looks 3 steps away.
        np.testing.assert_array_equal(part[6:-6], whole[start + 6 : start + 14])
