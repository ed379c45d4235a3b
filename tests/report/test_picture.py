"""Pictures of clouds: visible points, hidden points, and their places."""

import numpy as np
import pytest

from jaxscan.report.clouds import Viewpoint, draw_cloud


RED, GREEN, BLUE = (np.array(c, np.uint8) for c in ((220, 30, 30), (30, 200, 30), (30, 30, 220)))
SIZE = (320, 180)
FRONT = Viewpoint(eye=(0.0, 0.0, 0.0), target=(1.0, 0.0, 0.0), fov_deg=60.0, cut_away=False)


def square(distance, half, colour, step=0.004):
    y, z = np.meshgrid(np.arange(-half, half, step), np.arange(-half, half, step))
    p = np.stack([np.full(y.size, distance), y.ravel(), z.ravel()], -1)
    return p, np.broadcast_to(colour, p.shape)


def like(picture, colour):
    """Pixels whose hue is that of the colour, however shaded."""
    return np.argmax(picture, -1) == np.argmax(colour)


def test_near_hides_far():
    near, far = square(1.0, 0.2, RED), square(2.0, 0.8, BLUE)
    for order in ((near, far), (far, near)):
        xyz, rgb = (np.concatenate(parts) for parts in zip(*order, strict=True))
        picture = draw_cloud(xyz, rgb, size=SIZE, view=FRONT)
        assert picture.shape == (180, 320, 3) and picture.dtype == np.uint8
        middle = picture[60:120, 130:190]
        # 0.2 m at 1 m is 55 px on every side of the middle.
        assert (middle[..., 0] > 2 * middle[..., 2].astype(int)).all()
        assert (picture[90, 230:260, 2] > 100).all() and (picture[90, 300:] > 230).all()


def test_right_and_up_are_right_and_up():
    xyz = np.concatenate([square(2.0, 0.1, RED)[0] + [0, 0.5, 0], square(2.0, 0.1, GREEN)[0] + [0, 0, 0.4]])
    rgb = np.repeat([RED, GREEN], len(xyz) // 2, axis=0)
    picture = draw_cloud(xyz, rgb, size=SIZE, view=FRONT).astype(int)
    # Looking along x with z up, y is to the left.
    reds = np.argwhere(picture[..., 0] - picture[..., 1] > 80)
    greens = np.argwhere(picture[..., 1] - picture[..., 0] > 80)
    focal = 160 / np.tan(np.radians(30))
    np.testing.assert_allclose(reds.mean(0), [90, 160 - focal * 0.25], atol=2.0)
    np.testing.assert_allclose(greens.mean(0), [90 - focal * 0.2, 160], atol=2.0)


def box_room(colours):
    """Faces of a box room as seen from within: points, colours, normals."""
    size, step = np.array([4.0, 3.0, 2.5]), 0.02
    xyz, rgb, normals = [], [], []
    for axis in range(3):
        others = [i for i in range(3) if i != axis]
        a, b = np.meshgrid(*(np.arange(step / 2, size[i], step) for i in others))
        for side in (0, 1):
            p = np.zeros((a.size, 3))
            p[:, others[0]], p[:, others[1]], p[:, axis] = a.ravel(), b.ravel(), side * size[axis]
            normal = np.zeros(3)
            normal[axis] = 1.0 - 2.0 * side
            xyz.append(p - 0.5 * size)
            rgb.append(np.broadcast_to(colours[axis][side], p.shape))
            normals.append(np.broadcast_to(normal, p.shape))
    return (np.concatenate(parts) for parts in (xyz, rgb, normals))


@pytest.mark.parametrize("with_normals", [True, False])
def test_room_is_cut_open(with_normals):
    near_wall, far_wall, floor, ceiling = RED, GREEN, np.array([200, 180, 30], np.uint8), BLUE
    colours = [(near_wall, far_wall), (near_wall, far_wall), (floor, ceiling)]
    xyz, rgb, normals = box_room(colours)
    # Turned out of the axes, so that nothing depends on them.
    c, s = np.cos(0.5), np.sin(0.5)
    turn = np.array([[c, -s, 0], [s, c, 0], [0, 0, 1]])
    picture = draw_cloud(
        xyz @ turn.T, rgb.astype(np.uint8), normals=normals @ turn.T if with_normals else None, size=(480, 270)
    ).astype(int)
    red, green, blue = (picture[..., i] for i in range(3))
    is_floor = (red > 100) & (green > 90) & (blue < 80)
    is_far = (green > 100) & (red < 90)
    hidden = ((blue > 100) & (red < 90)) | ((red > 120) & (green < 70))
    # The floor and the far walls fill a good part of the picture, and nothing hides them.
    assert is_floor.mean() > 0.1 and is_far.mean() > 0.1
    assert hidden.mean() < 0.01
    drawn = np.argwhere((picture < 230).any(-1))
    low, high = drawn.min(0), drawn.max(0)
    assert (low > 0).all() and (high < np.array([269, 479])).all()
    assert high[0] - low[0] > 0.6 * 270


def test_sparse_profiles_are_joined():
    angle, height = np.meshgrid(np.radians(np.arange(-20, 21, 2.0)), np.linspace(-0.4, 0.4, 400), indexing="ij")
    far = np.where(np.arange(len(angle)) < 10, 2.0, 3.0)[:, None]
    xyz = np.stack([far + 0 * angle, far * np.tan(angle), far * height], -1)
    rgb = np.broadcast_to(BLUE, xyz.shape)
    picture = draw_cloud(xyz, rgb, size=SIZE, view=FRONT).astype(int)
    row = picture[90]
    seen = row[:, 2] - row[:, 0] > 50
    focal = 160 / np.tan(np.radians(30))
    joined, broken = (160 - focal * np.tan(np.radians(a)) for a in (-11.0, -1.0))
    # Columns between the profiles are filled, but not across the step between 2 m and 3 m.
    assert seen[int(160 - focal * np.tan(np.radians(19))) : int(160 - focal * np.tan(np.radians(1)))].all()
    assert seen[int(joined)] and not seen[int(broken)]


def test_empty_cloud():
    picture = draw_cloud(np.zeros((5, 7, 3)), np.zeros((5, 7, 3), np.uint8), size=SIZE)
    assert picture.shape == (180, 320, 3) and (picture > 230).all()
