"""Pictures of the room that the fisheye saw."""

import matplotlib


matplotlib.use("Agg")
import matplotlib.pyplot as plt
import numpy as np

import jaxscan
from experiments.paper.stage import Stage
from jaxscan.measurement.room import Dimension, RoomBox
from jaxscan.report.clouds import Viewpoint, draw_cloud


def draw_room(stage: Stage, cloud: jaxscan.PointCloud, box: RoomBox, shares: tuple[float, float]) -> None:
    """The room from above, from the side and from within.

    Args:
        stage: The world.
        cloud: The cloud of one turn.
        box: The dimensions measured in it.
        shares: Of all directions, those that the cloud covers and those in the field of the paper's camera [1].
    """
    xyz, valid = np.asarray(cloud.xyz), np.asarray(cloud.valid)
    xyz, rgb = np.where(valid[..., None], xyz, 0.0), np.asarray(cloud.rgb)
    along = np.array([0.0, 1.0, 0.0]) if box.length is None else box.length.direction
    ahead = along / np.linalg.norm(along)
    figure, axes = plt.subplot_mosaic(
        [["inside", "inside"], ["top", "side"]], figsize=(14, 13), height_ratios=(1.3, 1), layout="constrained"
    )
    within = Viewpoint((0.0, 0.0, 0.15), tuple(map(float, 3 * ahead)), fov_deg=110.0, cut_away=False)
    axes["inside"].imshow(draw_cloud(xyz, rgb, size=(1400, 750), view=within))
    axes["inside"].set_title("From the scanner's place, along the room")
    axes["inside"].axis("off")
    across = np.array([-ahead[1], ahead[0], 0.0])
    points = xyz[valid]
    x, y, z = points @ ahead, points @ across, points[:, 2]
    colour = np.clip(rgb[valid] / 200.0, 0, 1)
    below = z < 0.6
    order = np.flatnonzero(below)[np.argsort(z[below])]
    axes["top"].scatter(x[order], y[order], c=colour[order], s=1.2, lw=0)
    axes["top"].set(title="From above, without points higher than 0.6 m over the scanner", ylabel="across [m]")
    beyond = y > -0.3
    order = np.flatnonzero(beyond)[np.argsort(-y[beyond])]
    axes["side"].scatter(x[order], z[order], c=colour[order], s=1.2, lw=0)
    axes["side"].set(title="From the side, cut 0.3 m in front of the scanner", ylabel="up [m]")
    for one in (axes["top"], axes["side"]):
        one.plot(0, 0, "r^", ms=8)
        one.set(xlabel="along the room [m]", aspect="equal", xlim=_most(x))
        one.set_facecolor("0.95")
    axes["top"].set_ylim(_most(y))
    axes["side"].set_ylim(_most(z))
    sides = [f"{name} {1e3 * side.value_m:.1f} ± {1e3 * side.sigma_m:.1f} mm" for name, side in _sides(box)]
    seen = f"{100 * shares[0]:.0f} % of all directions are seen; by the paper's camera {100 * shares[1]:.0f} % at most"
    figure.suptitle(f"The room in one turn of a fisheye, {stage.world} world\n{', '.join(sides)}\n{seen}")
    figure.savefig(stage.picture("fisheye"), dpi=100)
    plt.close(figure)


def _most(values: np.ndarray) -> tuple[float, float]:
    """Limits of an axis that leave out a few strays."""
    low, high = np.percentile(values, [0.1, 99.9])
    return float(low) - 0.2, float(high) + 0.2


def _sides(box: RoomBox) -> list[tuple[str, Dimension]]:
    named = ((name, getattr(box, name)) for name in ("length", "width", "height"))
    return [(name, side) for name, side in named if side is not None]
