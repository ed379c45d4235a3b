"""Features and targets in the laser-off images of sweeps, as tracks."""

from collections import Counter, deque
from collections.abc import Iterator, Sequence
from concurrent.futures import Future, ThreadPoolExecutor
from typing import NamedTuple

import numpy as np
from jaxtyping import Float, Int

from jaxscan.geometry import AbstractBoard, Scanner, Turntable
from jaxscan.recalibration.observed import RecalibrationSettings, SweepStripes, Tracks
from jaxscan.recalibration.tracks.points import Sightings, keep_consistent, place_tracks, project_all, rays_of
from jaxscan.recalibration.tracks.seen import Cylinder, FeatureEyes, Followed, FoundTargets, ImageSource, Walk


_MOST_PIXELS = 6_000_000
"""Largest unrolled image; those of wider lenses are reduced."""
_STEEPEST = 3.0
"""Tangent of elevation at the borders of an unrolled image, at most: the axis itself has no azimuth."""
_BORDER = 200
_CELL = 4
"""Pixels between the places of which the pixel is computed; it is linear between them, by definition."""
_FAR_OUTSIDE = -1e7
_BACK_PX = 0.5
"""Error with which the ray of a pixel must come back to that pixel: lens models fold beyond the image."""


class Turning(NamedTuple):
    """Numbers of the camera's motion, by which unrolled places are predicted."""

    centre: Float[np.ndarray, "3"]
    """The camera's place at angle 0, scanner frame [m]."""
    scale: float

    @staticmethod
    def of(scanner: Scanner, scale: float) -> "Turning":
        """The motion of a scanner that a table turns."""
        return Turning(np.asarray(scanner.scanner_from_camera(), np.float64)[:3, 3], scale)

    def place(self, direction: Float[np.ndarray, "n 3"]) -> Float[np.ndarray, "n 2"]:
        """Unrolled places of directions in the scanner's frame at angle 0."""
        x, y, z = direction.T
        return self.scale * np.stack([np.arctan2(-y, x), -z / np.maximum(np.hypot(x, y), 1e-9)], -1)

    def direction(self, place: Float[np.ndarray, "n 2"]) -> Float[np.ndarray, "n 3"]:
        """Directions in the scanner's frame at angle 0, of length 1 across the axis."""
        azimuth, height = -place[:, 0] / self.scale, -place[:, 1] / self.scale
        return np.stack([np.cos(azimuth), np.sin(azimuth), height], -1)

    def predict(
        self, place: Float[np.ndarray, "n 2"], turn: float, range_m: Float[np.ndarray, " n"] | float
    ) -> Float[np.ndarray, "n 2"]:
        """Where points go when the scanner turns by `turn` [rad]; `range_m` is across the axis, from the camera."""
        point = self.centre + self.direction(place) * np.asarray(range_m)[..., None]
        return self.place(turn_about_z(point, -turn) - self.centre)


def turn_about_z(p: Float[np.ndarray, "n 3"], angle: float | Float[np.ndarray, " n"]) -> Float[np.ndarray, "n 3"]:
    """Points turned about the axis."""
    c, s = np.cos(angle), np.sin(angle)
    return np.stack([c * p[:, 0] - s * p[:, 1], s * p[:, 0] + c * p[:, 1], p[:, 2]], -1)


def unroll(scanner: Scanner, size: tuple[int, int]) -> Cylinder:
    """The unrolled image of a camera whose images have this width and height [px]."""
    width, height = size
    turning = Turning.of(scanner, 1.0)
    edge = turning.place(_directions(scanner, _border(width, height)))
    middle = turning.place(_directions(scanner, np.array([[width / 2.0, height / 2.0]])))[0, 0]
    # Azimuths are counted from the middle of the image, so that none jumps by a turn within it.
    azimuth = (edge[:, 0] - middle + np.pi) % (2 * np.pi) - np.pi + middle
    low = np.array([azimuth.min(), max(edge[:, 1].min(), -_STEEPEST)])
    high = np.array([azimuth.max(), min(edge[:, 1].max(), _STEEPEST)])
    focal = float(np.mean([scanner.camera.fx, scanner.camera.fy]))
    scale = min(focal, float(np.sqrt(_MOST_PIXELS / max(np.prod(high - low), 1e-9))))
    turning = turning._replace(scale=scale)
    cells = np.maximum(np.ceil((high - low) * scale / _CELL).astype(int), 1)
    row, column = np.mgrid[: cells[1] + 1, : cells[0] + 1] * float(_CELL)
    direction = turning.direction(np.stack([column.ravel(), row.ravel()], -1) + low * scale)
    direction /= np.linalg.norm(direction, axis=1, keepdims=True)
    q = project_all(scanner, turning.centre + direction, np.zeros(len(direction)))
    inside = (q >= 0).all(1) & (q[:, 0] <= width - 1) & (q[:, 1] <= height - 1)
    back = _directions(scanner, np.where(inside[:, None], q, 0.0))
    inside &= np.linalg.norm(back - direction, axis=1) < _BACK_PX / focal
    u, v = np.where(inside[:, None], q, _FAR_OUTSIDE).T.reshape(2, *row.shape)
    return Cylinder(_finer(u), _finer(v), float(low[0] * scale), float(low[1] * scale), scale)


def _directions(scanner: Scanner, q: Float[np.ndarray, "n 2"]) -> Float[np.ndarray, "n 3"]:
    """Directions of pixels in the scanner's frame at angle 0."""
    return rays_of(scanner, q, np.zeros(len(q))).direction


def _finer(values: Float[np.ndarray, "rows columns"]) -> Float[np.ndarray, "fine_rows fine_columns"]:
    """Values between those on a grid with cells of `_CELL` pixels, by linear interpolation; outside stays outside."""
    for axis in (0, 1):
        at = np.arange((values.shape[axis] - 1) * _CELL)
        low, part = at // _CELL, np.expand_dims(at % _CELL / _CELL, 1 - axis)
        values = np.take(values, low, axis) * (1 - part) + np.take(values, low + 1, axis) * part
    return values


def _border(width: int, height: int) -> Float[np.ndarray, "n 2"]:
    u, v = np.linspace(0, width - 1, _BORDER), np.linspace(0, height - 1, _BORDER)
    sides = [(u, 0 * u), (u, 0 * u + height - 1), (0 * v, v), (0 * v + width - 1, v)]
    return np.concatenate([np.stack(side, -1) for side in sides])


MOST_KEYS = 120
_SHARE = 0.6
"""Smallest share of an image's field of view that the next one shows too."""
_FEWEST_KEYS = 3


class KeyImages(NamedTuple):
    """Key images of a sweep, in the order in which the scanner turned."""

    record: Int[np.ndarray, " keys"]
    heading: Float[np.ndarray, " keys"]
    closing: Int[np.ndarray, " again"]
    """Numbers of the first key images, to which those after the last one lead again; empty without a full turn."""

    def walk(self) -> Int[np.ndarray, " steps"]:
        """The key image of each step."""
        return np.concatenate([np.arange(len(self.record)), self.closing])


def choose_keys(heading: Float[np.ndarray, " records"], field_rad: float) -> KeyImages | None:
    """Key images spread evenly over a turn [rad]; None where neighbours overlap too little, or it is too little."""
    order = np.argsort(heading, kind="stable")
    turned = float(np.ptp(heading)) if len(heading) else 0.0
    if len(heading) < _FEWEST_KEYS or turned <= 0:
        return None
    wanted = np.linspace(heading.min(), heading.max(), min(MOST_KEYS, len(heading)))
    at = np.unique(_nearest(heading[order], wanted))
    record = order[at]
    angle = heading[record]
    widest = (1.0 - _SHARE) * field_rad
    if len(record) < _FEWEST_KEYS or np.diff(angle).max() > widest:
        return None
    # After the last image comes the first one that lies beyond it, a turn earlier.
    beyond = np.flatnonzero(angle + 2 * np.pi > angle[-1] - 1e-9)
    gap = angle[beyond[0]] + 2 * np.pi - angle[-1] if len(beyond) else np.inf
    again = np.flatnonzero((angle + 2 * np.pi > angle[-1] - 1e-9) & (angle < angle[-1] - 2 * np.pi + field_rad))
    return KeyImages(record, angle, again if gap <= widest else np.zeros(0, int))


def _nearest(ascending: np.ndarray, wanted: np.ndarray) -> np.ndarray:
    """Numbers of the values nearest to the wanted ones."""
    right = np.clip(np.searchsorted(ascending, wanted), 1, len(ascending) - 1)
    return np.where(wanted - ascending[right - 1] <= ascending[right] - wanted, right - 1, right)


_AHEAD, _THREADS = 4, 2
_LEVEL, _BRIGHT = 90.0, 250
_MOST_BRIGHT = 0.02
"""Share of saturated pixels in the chosen exposure, at most."""


class Reader:
    """Reads grey laser-off images of one exposure."""

    def __init__(self, capture: ImageSource, eyes: FeatureEyes) -> None:
        self._capture, self._to_grey = capture, eyes.to_grey
        self._exposure = 0
        images = capture.records[0].off
        if len(images) > 1:
            grey = [self._grey(image) for image in images]
            clear = [k for k, g in enumerate(grey) if (g >= _BRIGHT).mean() <= _MOST_BRIGHT] or [0]
            self._exposure = min(clear, key=lambda k: abs(float(np.median(grey[k])) - _LEVEL))

    def read(self, record: int) -> np.ndarray:
        """The image of one record, uint8 [rows, columns]."""
        images = self._capture.records[record].off
        return self._grey(images[min(self._exposure, len(images) - 1)])

    def ahead(self, records: Int[np.ndarray, " n"]) -> Iterator[np.ndarray]:
        """The images of some records in order, decoded in threads."""
        with ThreadPoolExecutor(_THREADS) as pool:
            waiting: deque[Future[np.ndarray]] = deque()
            try:
                for record in records:
                    waiting.append(pool.submit(self.read, int(record)))
                    if len(waiting) > _AHEAD:
                        yield waiting.popleft().result()
                while waiting:
                    yield waiting.popleft().result()
            finally:
                for future in waiting:
                    future.cancel()

    def _grey(self, reference: object) -> np.ndarray:
        return self._to_grey(self._capture.image(reference), self._capture.pixel_format)


_LOOKED_AT = 6
"""Images by which texture is judged."""
_SEARCHED = 16
"""Images in which the dictionary of markers is looked for."""
_NOMINAL_RANGE_M = 2.5
"""Distance that a feature is assumed to have before it has moved."""
_LEAST_SHARE = 0.3
"""If a smaller share of the features fits the turn, none is used."""
_FEWEST_TRACKS = 20
_SIGHTINGS = 8
"""Sightings of a track that are used, at most: neighbouring ones share the blur and bend of a feature."""


class _Seen(NamedTuple):
    """Sightings of one sweep, and a name for each track; "" for a feature."""

    sightings: Sightings
    record: np.ndarray
    names: tuple[str, ...]


def observe_features(
    captures: Sequence[ImageSource],
    sweeps: Sequence[SweepStripes],
    scanner: Scanner,
    eyes: FeatureEyes,
    settings: RecalibrationSettings,
    board: AbstractBoard | None = None,
) -> tuple[Tracks | None, tuple[str, ...]]:
    """Find targets, and follow features, through the laser-off images of sweeps.

    Args:
        captures: The sweeps' images; their angles are taken from `sweeps`.
        sweeps: The same sweeps' stripes, in the same order: names, angles, stations.
        scanner: The stored scanner, which predicts where features go.
        eyes: The functions that look at images; `vision.feature_eyes` makes them.
        settings: With `features`.
        board: A board that was left standing.

    Returns:
        tracks: A feature is a track of one sweep; a target has one number in all sweeps. Points are in the frame of
            the first station that sees them, until `place_tracks` knows the stations. None without any.
        notes: A sentence for each thing that a user should know.
    """
    parts: list[tuple[int, _Seen]] = []
    notes: list[str] = []
    for number, (capture, sweep) in enumerate(zip(captures, sweeps, strict=True)):
        seen, said = _observe_sweep(capture, sweep, scanner, eyes, settings, board)
        notes += [f"{sweep.name}: {note}" for note in said]
        parts += [(number, one) for one in seen]
    tracks = _joined(parts, sweeps, scanner) if parts else None
    if tracks is not None and not len(tracks.point):
        notes.append("features: none could be placed in the room; a camera on the axis sees no depth by turning.")
    return tracks, tuple(notes)


def _observe_sweep(
    capture: ImageSource,
    sweep: SweepStripes,
    scanner: Scanner,
    eyes: FeatureEyes,
    settings: RecalibrationSettings,
    board: AbstractBoard | None,
) -> tuple[list[_Seen], list[str]]:
    """Consistent sightings of one sweep: of targets, and of features."""
    found = capture.image_size
    expected = (int(scanner.camera.width), int(scanner.camera.height))
    if found != expected:
        return [], [
            f"no features: found images of {found[0]} x {found[1]} px, expected {expected[0]} x {expected[1]} px."
        ]
    if not capture.records or not all(record.off for record in capture.records):
        return [], ["no features: it has no laser-off images."]
    if scanner.turntable.carries == "nothing" or len(capture.records) < 3:
        return [], ["no features: they need a scanner that moves, and at least three records."]
    reader = Reader(capture, eyes)
    spread = np.unique(np.linspace(0, len(capture.records) - 1, MOST_KEYS).round().astype(int))
    some = spread[np.unique(np.linspace(0, len(spread) - 1, _SEARCHED).round().astype(int))]
    images = list(reader.ahead(some))
    dictionary = eyes.find_dictionary(images)
    out: list[_Seen] = []
    notes: list[str] = []
    if dictionary is not None or board is not None:
        targets = [eyes.find_targets(image, board, dictionary) for image in reader.ahead(spread)]
        seen, said = _keep_targets(scanner, sweep, spread, targets)
        out, notes = out + seen, notes + said
    if settings.features is not False:
        seen, said = _features(reader, sweep, scanner, eyes, settings.features, images)
        out, notes = out + seen, notes + said
    return out, notes


def _features(
    reader: Reader,
    sweep: SweepStripes,
    scanner: Scanner,
    eyes: FeatureEyes,
    wanted: bool | None,
    images: list[np.ndarray],
) -> tuple[list[_Seen], list[str]]:
    """Consistent sightings of features, and why there are none."""
    table = scanner.turntable
    if not isinstance(table, Turntable) or table.carries != "scanner":
        return [], ["features are off: they need a table that turns the scanner."] if wanted else []
    enough, reason = eyes.has_texture(images[:: max(1, len(images) // _LOOKED_AT)])
    if not enough and not wanted:
        return [], [f"features are off: too little texture ({reason})."]
    cylinder = unroll(scanner, (int(scanner.camera.width), int(scanner.camera.height)))
    heading = np.asarray(table.angle(np.asarray(sweep.angle, np.float64)))
    keys = choose_keys(heading, cylinder.u.shape[1] / cylinder.scale)
    if keys is None:
        return [], ["features are off: neighbouring images overlap by less than 60 %, or the table hardly turned."]
    turning, walk = Turning.of(scanner, cylinder.scale), keys.walk()

    def predict(place: np.ndarray, first: int, second: int) -> np.ndarray:
        turn = float(keys.heading[walk[second]] - keys.heading[walk[first]])
        return turning.predict(place, turn, _NOMINAL_RANGE_M)

    steps = Walk(cylinder, predict, len(walk), len(keys.record))
    followed = _thinned(eyes.follow(reader.ahead(keys.record[walk]), steps))
    return _keep_features(scanner, sweep, keys, followed)


def _thinned(followed: Followed) -> Followed:
    """At most `_SIGHTINGS` sightings of each track: the first, the last, and others evenly between them."""
    order = np.lexsort((followed.step, followed.track))
    start, count = np.unique(followed.track[order], return_index=True, return_counts=True)[1:]
    place = np.arange(len(order)) - np.repeat(start, count)
    last, most = np.repeat(count - 1, count), np.minimum(np.repeat(count, count), _SIGHTINGS) - 1
    # Keeps places evenly spread by rank: where the rounded rank steps up.
    share = np.floor(place * most / np.maximum(last, 1) + 1e-9)
    before = np.floor((place - 1) * most / np.maximum(last, 1) + 1e-9)
    return Followed(*(field[order[share > before]] for field in followed))


def _keep_features(
    scanner: Scanner, sweep: SweepStripes, keys: KeyImages, followed: Followed
) -> tuple[list[_Seen], list[str]]:
    if not len(followed.q):
        return [], ["features are off: none was found again in the next image."]
    key = keys.walk()[followed.step]
    record = keys.record[key]
    sightings = Sightings(followed.q, followed.sigma, sweep.angle[record], key, followed.track, np.zeros(len(key), int))
    tested = keep_consistent(scanner, sightings)
    share, tracks = float(tested.kept.mean()), len(np.unique(followed.track[tested.kept]))
    if share < _LEAST_SHARE or tracks < _FEWEST_TRACKS:
        return [], [
            f"features are off: {tracks} of {followed.track.max() + 1} follow the turn of the table; check its steps "
            "per turn and the calibration."
        ]
    kept = sightings._replace(sigma=tested.sigma).take(tested.kept)
    return [_Seen(kept, record[tested.kept], ("",) * (int(followed.track.max()) + 1))], []


def _keep_targets(
    scanner: Scanner, sweep: SweepStripes, records: np.ndarray, targets: list[FoundTargets]
) -> tuple[list[_Seen], list[str]]:
    """Consistent sightings of targets, and notes on those that are left out."""
    twice = sorted({name for one in targets for name, n in Counter(one.name).items() if n > 1})
    double = {_target(name) for name in twice}
    names = sorted({name for one in targets for name in one.name if _target(name) not in double})
    notes = [f"{target} is in the room twice: it is left out." for target in sorted(double)]
    if not names:
        return [], notes
    number = {name: k for k, name in enumerate(names)}
    every = [(k, j) for k, one in enumerate(targets) for j, name in enumerate(one.name) if name in number]
    image = np.array([k for k, _ in every])
    track = np.array([number[targets[k].name[j]] for k, j in every])
    q = np.array([targets[k].q[j] for k, j in every])
    sigma = np.array([targets[k].sigma[j] for k, j in every])
    kind = np.array([int(names[t].startswith("board")) for t in track])
    record = records[image]
    sightings = Sightings(q, sigma, sweep.angle[record], image, track, kind)
    tested = keep_consistent(scanner, sightings)
    before, after = (np.bincount(track, weight, len(names)) for weight in (np.ones(len(track)), tested.kept))
    lost = {_target(names[t]) for t in np.flatnonzero((before >= 3) & (after == 0))}
    still = {_target(names[t]) for t in np.flatnonzero(after > 0)}
    notes += [f"{target} moves, or is in the room twice: it is left out." for target in sorted(lost - still)]
    if not tested.kept.any():
        return [], notes
    kept = sightings._replace(sigma=tested.sigma).take(tested.kept)
    return [_Seen(kept, record[tested.kept], tuple(names))], notes


def _target(name: str) -> str:
    """The target that a corner belongs to."""
    return name.rsplit(" corner ", 1)[0]


def _joined(parts: list[tuple[int, _Seen]], sweeps: Sequence[SweepStripes], scanner: Scanner) -> Tracks:
    """The tracks of all sweeps; targets of one name are one track."""
    names: list[str] = []
    known: dict[str, int] = {}
    rows: list[tuple[np.ndarray, ...]] = []
    for sweep, seen in parts:
        number = np.full(len(seen.names), -1)
        for track in np.unique(seen.sightings.track):
            name = seen.names[track]
            if name and name in known:
                number[track] = known[name]
                continue
            number[track] = len(names)
            names.append(name)
            if name:
                known[name] = len(names) - 1
        s = seen.sightings
        rows.append((s.q, s.sigma, np.full(len(s.q), sweep), seen.record, number[s.track]))
    q, sigma, sweep_of, record, track = (np.concatenate(column) for column in zip(*rows, strict=True))
    point = np.zeros((len(names), 3))
    tracks = Tracks(q, sigma, sweep_of, record, track, point, tuple(names) if any(names) else ())
    return place_tracks(tracks, sweeps, scanner)
