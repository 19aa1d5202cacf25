"""Selection of stations: rests of base and head, or keyframes if the robot does not rest."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from typing import TypeVar

import numpy as np

from mobilecal_cli.errors import RecordingError, usable
from mobilecal_cli.kinematics import encoder_step_rad
from mobilecal_cli.model.arrays import BoolArray, FloatArray, IntArray
from mobilecal_cli.model.observations import WheelTrack
from mobilecal_cli.model.rig import HeadChain, Side, camera_words, shots_words
from mobilecal_cli.model.signals import (
    FEW_READINGS,
    NO_IMAGES,
    PictureIndex,
    Rejection,
    Shot,
    Signals,
    Station,
    Track,
)
from mobilecal_cli.model.text import capitalized, listed

PAIR_AT_REST_S = 0.1  # nothing moves, so the two images need not be simultaneous
PAIR_MOVING_S = 0.005
REST_WINDOW_S = 0.3
STILL_REVOLUTE_RAD = 0.006  # range over the window: six times a joint noise of 0.05 degrees
STILL_PRISMATIC_M = 0.002
STILL_WHEEL_RAD = 0.004  # or one step of a coarse encoder
LARGEST_GAP_S = 0.5
_WHEEL_INTERVAL_S = 0.125  # usual one; over longer ones, what the base does is not known well enough
SHOTS_PER_REST = 10
RESTS_ENOUGH = 8  # fewer stations are not enough
KEYFRAMES = 80
MOST_IN_MOTION = 2000  # of a recording: the estimate takes 1.5 MB of memory each
# One camera records nothing for so long, while the other has so many images; or all cameras for so many times the
# longest other break between images, while the robot moves.
_SILENT_S, _MISSED_IMAGES, _OTHER_BREAKS = 3.0, 5, 2
_NEARLY_ALL = 0.9  # of a topic's images
_ALONE_S = 1.0  # an image of one camera this near to a group of images is not used
_MISSED_PAIRS = 2  # without readings around them; one happens at the ends of a recording
FROZEN_S = 1.0  # a driver that repeats images shows new ones earlier
# Reasons for pairs that are not used, and what to do.
NO_READINGS, FROZEN = "no readings around the image", "images do not change while the robot moves"
_RATE = "joints and wheels at 20 Hz or more"
_NOT_USED = {
    NO_READINGS: "no readings around them ({0}). Check the cable and the driver, which must publish at rest, too.",
    FEW_READINGS: f"{FEW_READINGS} ({{0}}). Publish {_RATE}, or stop longer at each place.",
    FROZEN: "the {0} images stay the same while the robot moves. Check the driver of the {0} camera.",
}
_NS = 1_000_000_000
T = TypeVar("T")


@dataclass(frozen=True, slots=True, eq=False)
class Plan:
    """Stations selected in one log.

    Attributes:
        stations: in order of time.
        wheels: both wheels.
        joints: the head's joints, in the order of `HeadChain.joints`.
        images: camera → the images of the stations.
        rejections: images that cannot be used, with the reason.
    """

    stations: tuple[Station, ...]
    wheels: WheelTrack
    joints: tuple[Track, ...]
    images: Mapping[str, PictureIndex]
    rejections: tuple[Rejection, ...]

    @property
    def tracks(self) -> tuple[Track, ...]:
        """Of the right and the left wheel and of the joints."""
        return (self.wheels.right, self.wheels.left, *self.joints)


def wheel_track(wheels: Mapping[Side, Track]) -> WheelTrack:
    """Both wheels of a recording, each with its own readings.

    Raises:
        RecordingError: the two do not overlap in time.
    """
    track = WheelTrack(wheels["right"], wheels["left"])
    if len(track.time_ns) < 2:
        raise RecordingError(
            "the readings of the left and right wheel do not overlap in time",
            "record both wheels during the whole recording; check that both topics use the same clock",
        )
    return track


def shots_of(images: Mapping[str, PictureIndex], tolerance_s: float) -> tuple[Shot, ...]:
    """Each image of one camera alone; of several, each image of the first with the nearest of the others in time.

    An image is in one shot at most. Images of the others without one of the first are grouped likewise, from the second
    camera on. An image alone counts only where no group is near.

    Raises:
        RecordingError: no two images of two cameras are within the tolerance.
    """
    times = [index.time_ns for index in images.values()]
    shots: list[Shot] = []
    unused = [np.ones(len(of_camera), dtype=np.bool_) for of_camera in times]
    for k, of_camera in enumerate(times):
        own = np.flatnonzero(unused[k])
        groups: list[list[int | None]] = [[None] * k + [int(of_camera[i])] for i in own]
        for other in range(k + 1, len(times)):
            free = np.flatnonzero(unused[other])
            nearest = _nearest(of_camera[own], times[other][free], tolerance_s)
            unused[other][free[list(nearest.values())]] = False
            for i, group in enumerate(groups):
                group.append(int(times[other][free[nearest[i]]]) if i in nearest else None)
        shots += [Shot(tuple(group)) for group in groups]
    grouped_ns = np.sort([shot.time_ns for shot in shots if len(shot.taken_ns) > 1])
    if len(times) == 2 and not len(grouped_ns):
        left_ns, right_ns = times
        closest_ns = min(int(np.abs(right_ns - at).min()) for at in left_ns)
        left, right = images
        raise RecordingError(
            f"no stereo pairs: of {len(left_ns)} {left} and {len(right_ns)} {right} images, "
            f"the closest two are {closest_ns / _NS:.3f} s apart (limit {tolerance_s:g} s)",
            "check that both cameras use the same clock and are triggered together",
        )
    begins, ends = (np.array([shot.time_ns for shot in shots]) + by * _ALONE_S * _NS for by in (-1, 1))
    near = np.searchsorted(grouped_ns, begins) < np.searchsorted(grouped_ns, ends, side="right")
    kept = [shot for shot, beside in zip(shots, near, strict=True) if len(shot.taken_ns) > 1 or not beside]
    return tuple(sorted(kept, key=lambda shot: shot.time_ns))


def _nearest(one_ns: IntArray, other_ns: IntArray, tolerance_s: float) -> dict[int, int]:
    """Index of each image of one camera → index of the nearest one of another, which is in one pair at most."""
    if not len(one_ns) or not len(other_ns):
        return {}
    nearest = np.searchsorted(other_ns[:-1] + np.diff(other_ns) // 2, one_ns)
    distance_ns = np.abs(one_ns - other_ns[nearest])
    best: dict[int, int] = {}
    for i in np.argsort(distance_ns, kind="stable"):
        if distance_ns[i] <= tolerance_s * _NS:
            best.setdefault(int(nearest[i]), int(i))
    return {i: j for j, i in best.items()}


def _elsewhere(signals: Signals, since_ns: int, until_ns: int) -> str:
    """Which topics of no camera have nearly all of their images in a stretch of time without others, "" for none."""
    shares = {
        topic: np.mean((times_ns >= since_ns) & (times_ns <= until_ns))
        for topic, times_ns in signals.other_images.items()
    }
    topics = [topic for topic, share in shares.items() if share > _NEARLY_ALL]
    return (
        f"The images of this time are on {listed(topics)}. Record each camera on one topic." if topics else ""
    )


def _silences(log: _Pairs) -> Iterator[str]:
    """A note where one camera recorded nothing for a while and another did: a cable, or a full disk."""
    recorded_ns = log.signals.recorded_ns
    for name, own in recorded_ns.items() if len(recorded_ns) > 1 else ():
        other = max((k for k in recorded_ns if k != name), key=lambda k: len(recorded_ns[k]))
        others = recorded_ns[other]
        edges = np.sort(np.concatenate([own, others[[0, -1]]]))
        longest = int(np.argmax(np.diff(edges)))
        begin, end = edges[longest : longest + 2]
        inside = others[(others >= begin) & (others <= end)]
        bounds = own[(own == begin) | (own == end)]
        paired = np.abs(inside[:, None] - bounds) <= PAIR_AT_REST_S * _NS
        missed = int(np.sum(~paired.any(axis=1)))
        if end - begin > _SILENT_S * _NS and missed >= _MISSED_IMAGES:
            since = (begin - min(own[0], others[0])) / _NS
            check = f"Check the cable and the driver of the {camera_words(name)}."
            yield (
                f"No {name} images for {(end - begin) / _NS:.0f} s, from {since:.0f} s after the first image on, "
                f"while there are {missed} {other} images. {_elsewhere(log.signals, begin, end) or check}"
            )


@dataclass(frozen=True, slots=True, eq=False)
class _Channel:
    """A track and its allowed range during a rest."""

    name: str
    track: Track
    tolerance: float

    @property
    def interval_s(self) -> float:
        """Usual time between two readings, s; 0 for one reading."""
        return float(np.median(np.diff(self.track.time_ns) if len(self.track.time_ns) > 1 else 0)) / _NS

    def covers(self, times_ns: IntArray) -> BoolArray:
        """Whether readings exist near each time, or are equal before and after it, (n,)."""
        stamps = self.track.time_ns
        after = np.searchsorted(stamps, times_ns)
        inside = (after > 0) & (after < len(stamps)) | np.isin(times_ns, stamps)
        right = np.clip(after, 0, len(stamps) - 1)
        left = np.clip(after - 1, 0, len(stamps) - 1)
        close = stamps[right] - stamps[left] <= LARGEST_GAP_S * _NS
        same = np.abs(self.track.value[right] - self.track.value[left]) <= self.tolerance
        return inside & (close | same)

    def wander(self, begin_ns: int, end_ns: int) -> float:
        """Range of the values within a time interval."""
        lo, hi = np.searchsorted(self.track.time_ns, [begin_ns, end_ns])
        ends = self.track.at(np.array([begin_ns, end_ns]))
        return float(np.ptp(np.concatenate([ends, self.track.value[lo:hi]])))


def _channels(signals: Signals, prismatic: frozenset[str]) -> list[_Channel]:
    joints = [
        _Channel(name, track, STILL_PRISMATIC_M if name in prismatic else STILL_REVOLUTE_RAD)
        for name, track in signals.joints.items()
    ]
    together = np.array_equal(signals.wheels["right"].time_ns, signals.wheels["left"].time_ns)  # of one topic
    wheels = [
        _Channel(
            "wheels" if together else f"{side} wheel",
            track,
            max(STILL_WHEEL_RAD, 1.1 * encoder_step_rad(track.value)),
        )
        for side, track in signals.wheels.items()
    ]
    return joints + wheels


def _still(channels: Sequence[_Channel], begin_ns: int, end_ns: int) -> bool:
    """Whether nothing moves within a time interval."""
    return all(channel.wander(begin_ns, end_ns) <= channel.tolerance for channel in channels)


def _rests(pairs: list[Shot], channels: list[_Channel]) -> list[list[Shot]]:
    """Runs of pairs without motion; each pair is still within a window around itself."""
    half = int(REST_WINDOW_S / 2 * _NS)
    runs: list[list[Shot]] = []
    for pair in pairs:
        if not _still(channels, pair.time_ns - half, pair.time_ns + half):
            continue
        if runs and _still(channels, runs[-1][0].time_ns, pair.time_ns):
            runs[-1].append(pair)
        else:
            runs.append([pair])
    return runs


def _far_apart(features: FloatArray, count: int) -> IntArray:
    """Indices of rows far apart: each new row is the farthest from those already chosen."""
    chosen = [0]
    distance = np.linalg.norm(features - features[0], axis=1)
    while len(chosen) < min(count, len(features)) and distance.max() > 0:
        chosen.append(int(np.argmax(distance)))
        distance = np.minimum(distance, np.linalg.norm(features - features[chosen[-1]], axis=1))
    return np.sort(chosen)


def _keyframes(pairs: list[Shot], channels: list[_Channel]) -> list[Shot]:
    """Sharp moments of a recording in motion, spread over head angles, heading and distance driven."""
    if not pairs:
        return []
    times = np.array([pair.time_ns for pair in pairs])
    values = np.stack([c.track.at(times) for c in channels], axis=1)
    half = int(0.05 * _NS)  # a few readings, over which the speed hardly changes
    rates = np.stack([c.track.at(times + half) - c.track.at(times - half) for c in channels], axis=1)
    speed = np.linalg.norm(rates, axis=1)
    # The slower half of every two seconds: sharp images from all parts of the recording.
    bins = (times - times[0]) // (2 * _NS)
    parts = np.split(speed, np.flatnonzero(np.diff(bins)) + 1)  # pairs are in order of time
    slow = np.concatenate([part <= np.median(part) for part in parts])
    spans = np.ptp(values, axis=0)
    features = values[slow] / np.where(spans > 0, spans, 1.0)
    picked = np.flatnonzero(slow)[_far_apart(features, KEYFRAMES)]
    return [pairs[i] for i in picked]


def spread(items: Sequence[T], most: int) -> list[T]:
    """At most so many of the items, evenly spread."""
    chosen = np.linspace(0, len(items) - 1, most) if len(items) > most else np.arange(len(items))
    return [items[k] for k in np.round(chosen).astype(int)]


def _station(index: int, pairs: list[Shot], at_rest: bool, tracks: Sequence[Track]) -> Station:
    """A station with the mean readings from its first to its last pair."""
    times = np.array([pair.time_ns for pair in pairs])
    mean, scatter = [], []
    for track in tracks:
        begin = int(np.searchsorted(track.time_ns, times[0]))
        within = track.value[begin : int(np.searchsorted(track.time_ns, times[-1], side="right"))]
        readings = within if len(within) >= 3 else track.at(times)
        mean.append(float(readings.mean()))
        scatter.append(float(readings.std(ddof=1)) if len(pairs) > 1 else 0.0)
    time_ns = int(times[0]) + round(float(np.mean(times - times[0])))
    return Station(index, at_rest, tuple(pairs), time_ns, np.array(mean), np.array(scatter))


def _blind(log: _Pairs) -> Iterator[str]:
    """A note where no camera records anything for a while, and the robot moves: a cable, a driver, or a full disk."""
    recorded_ns, channels = log.signals.recorded_ns, log.channels
    taken = np.unique(np.concatenate([*recorded_ns.values()]))
    begin_ns = max(int(c.track.time_ns[0]) for c in channels)
    end_ns = min(int(c.track.time_ns[-1]) for c in channels)
    edges = np.unique([*taken[(taken > begin_ns) & (taken < end_ns)], begin_ns, end_ns])
    breaks = np.diff(edges)
    if not len(breaks):
        return
    longest = int(np.argmax(breaks))
    usual_ns = int(np.delete(breaks, longest).max(initial=0))
    since, until = (int(at) for at in edges[longest : longest + 2])
    long_ns = max(_SILENT_S * _NS, _OTHER_BREAKS * usual_ns)
    if until - since > long_ns and not _still(channels, since, until):
        which = camera_words(*recorded_ns) if len(recorded_ns) == 1 else "cameras"
        check = f"Check the {which}, cables and drivers, and the recorder."
        yield (
            f"{NO_IMAGES} {(until - since) / _NS:.0f} s, from {(since - begin_ns) / _NS:.0f} s after the first "
            f"reading on, while the robot moves. {_elsewhere(log.signals, since, until) or check}"
        )


@dataclass(frozen=True, slots=True, eq=False)
class _Pairs:
    """The shots of a log with these signals.

    Attributes:
        channels: its joints and wheels.
        rests: the shots with readings of all of them and new images, in which nothing moves, by rest.
        moving: those taken in motion, in order of time; where the images are too far apart for it, in parts.
        split: number of shots in motion that are in parts.
        rejections: shots without readings, or with an image that has not changed since the robot moved.
    """

    signals: Signals
    wheels: WheelTrack
    channels: list[_Channel]
    rests: list[list[Shot]]
    moving: list[Shot]
    split: int
    rejections: list[Rejection]


def _paired(signals: Signals, prismatic: frozenset[str]) -> _Pairs:
    """Find the shots of a log, and its rests."""
    wheels = wheel_track(signals.wheels)
    channels = _channels(signals, prismatic)
    pairs, what = list(shots_of(signals.images, PAIR_AT_REST_S)), shots_words(len(signals.images))
    times = np.array([pair.time_ns for pair in pairs])
    rejections: list[Rejection] = []
    covered = np.ones(len(pairs), dtype=bool)
    slow = {
        c.name: f"{c.name} {1 / c.interval_s:.2g} per second"
        for c in channels
        if c.interval_s > LARGEST_GAP_S and c.track.time_ns[0] < times[-1] and times[0] < c.track.time_ns[-1]
    }
    few = f"{', '.join(slow.values())}; at least {1 / LARGEST_GAP_S:g} needed in motion"
    lacking: dict[str, str] = {}
    for channel in channels:
        missing = ~channel.covers(times)
        reason, detail = (FEW_READINGS, few) if channel.name in slow else (NO_READINGS, channel.name)
        if missing.any():
            lacking[detail] = reason
        rejections += [Rejection("stations", reason, detail, int(at)) for at in times[missing & covered]]
        covered &= ~missing
    if not covered.any():
        raise RecordingError(
            f"none of {len(pairs)} {what} has readings of all joints and wheels around it; missing: "
            f"{', '.join(lacking)}",
            f"publish {_RATE}, or stop longer at each place"
            if FEW_READINGS in lacking.values()
            else "check that cameras, joints and wheels use the same clock and were recorded at the same time",
        )
    shown = _Shown(signals.images)
    pairs, frozen = shown.current([pair for pair, ok in zip(pairs, covered, strict=True) if ok], channels)
    if not pairs:
        raise RecordingError(
            f"the images of all {len(frozen)} {what} were taken before the last motion of the robot: they do not "
            "change",
            "check the cameras and their drivers, and record again",
        )
    runs = _rests(pairs, channels)
    resting = {pair for run in runs for pair in run}
    rests = [own for run in runs if (own := shown.new(run))]
    new = shown.new([pair for pair in pairs if pair not in resting])
    parts = [pair.split(PAIR_MOVING_S * _NS) for pair in new]
    moving = sorted((shot for part in parts for shot in part), key=lambda shot: shot.time_ns)
    split = sum(len(part) > 1 for part in parts)
    return _Pairs(signals, wheels, channels, rests, moving, split, [*rejections, *frozen])


class _Shown:
    """Which images of a log are new: cameras and drivers may repeat an image, with new stamps."""

    def __init__(self, images: Mapping[str, PictureIndex]) -> None:
        self._since = {
            name: dict(zip(index.time_ns.tolist(), index.since_ns.tolist(), strict=True))
            for name, index in images.items()
        }
        self._used: set[tuple[str, int]] = set()

    def _of(self, shot: Shot) -> list[tuple[str, int, int]]:
        """Camera and time of each image, and when it was shown first."""
        cameras = zip(self._since.items(), shot.times_ns, strict=True)
        return [(name, at_ns, since[at_ns]) for (name, since), at_ns in cameras if at_ns is not None]

    def current(
        self, pairs: Sequence[Shot], channels: Sequence[_Channel]
    ) -> tuple[list[Shot], list[Rejection]]:
        """Pairs with images newer than the last motion of the robot, and rejections of those with a frozen camera."""
        kept: list[Shot] = []
        frozen: list[Rejection] = []
        moved: set[tuple[str, int]] = set()  # camera, and time of its last new image: tested once
        for pair in pairs:
            stale: dict[str, int] = {}
            for name, at_ns, since_ns in self._of(pair):
                is_new = since_ns == at_ns
                if (name, since_ns) in moved or not (is_new or _still(channels, since_ns, at_ns)):
                    moved.add((name, since_ns))
                    stale[name] = at_ns - since_ns
            if not stale:
                kept.append(pair)
            elif max(stale.values()) > FROZEN_S * _NS:
                frozen.append(Rejection("stations", FROZEN, " and ".join(stale), pair.time_ns))
        return kept, frozen

    def new(self, pairs: Sequence[Shot]) -> list[Shot]:
        """The pairs, in order of time, with images that no pair has that was passed before."""
        kept = []
        for pair in pairs:
            shown = {(name, since_ns) for name, _, since_ns in self._of(pair)}
            if self._used.isdisjoint(shown):
                kept.append(pair)
                self._used |= shown
        return kept


def _slow_wheels(channels: Sequence[_Channel]) -> Iterator[str]:
    """A note on wheels that are published slowly."""
    for channel in channels:
        if channel.interval_s > _WHEEL_INTERVAL_S:
            yield (
                f"{channel.name}: {FEW_READINGS} ({1 / channel.interval_s:.2g}, at least {1 / _WHEEL_INTERVAL_S:g} "
                f"needed). The path between two readings is uncertain. Publish {_RATE}."
            )


def _not_used(log: _Pairs) -> Iterator[str]:
    """A note on shots that are not used, for each reason and joint, wheel or camera."""
    what = shots_words(len(log.signals.images))
    first_ns = min(int(index.time_ns.min()) for index in log.signals.images.values())
    for reason, name in dict.fromkeys((r.reason, r.detail) for r in log.rejections):
        times = [r.time_ns for r in log.rejections if (r.reason, r.detail) == (reason, name)]
        if len(times) < _MISSED_PAIRS:
            continue
        since, until = ((at - first_ns) / _NS for at in (min(times), max(times)))
        yield (
            f"{len(times)} {what} between {since:.0f} and {until:.0f} s after the first image are not used: "
            f"{_NOT_USED[reason].format(name)}"
        )


def plan_stations(
    logs: Sequence[Signals], chain: HeadChain, everything: bool = False
) -> tuple[tuple[Plan, ...], tuple[str, ...]]:
    """Select the moments of a recording at which to search for the board.

    Rests are used if the recording has at least eight. Otherwise at most 80 single sharp images, spread over head
    angles and base motion, supplement the rests.

    Args:
        logs: the recording, or its pieces between clock steps.
        chain: base to head.
        everything: use all image pairs instead: all of each rest, and all taken in motion, at most `MOST_IN_MOTION`.

    Returns:
        A plan for each log, and notes: complete sentences for the report. Logs without usable stereo pairs are left
        out, which is noted.

    Raises:
        RecordingError: no stereo pairs, or no pair with readings of all joints and wheels.
    """
    paired, problems = usable(logs, lambda signals: _paired(signals, chain.prismatic))
    rests = sum(len(log.rests) for log in paired)
    plans, moving, picked = [], 0, 0
    for log in paired:
        moments = [(run, True) for run in log.rests]
        if everything or rests < RESTS_ENOUGH:
            chosen = (
                spread(log.moving, MOST_IN_MOTION) if everything else _keyframes(log.moving, log.channels)
            )
            moments += [([pair], False) for pair in chosen]
            moving, picked = moving + len(log.moving), picked + len(chosen)
        if not everything:
            moments = [(spread(run, SHOTS_PER_REST), at_rest) for run, at_rest in moments]
        tracks = tuple(log.signals.joints[name] for name in chain.joints)
        moments.sort(key=lambda moment: moment[0][0].time_ns)
        stations = tuple(_station(i, *moment, tracks) for i, moment in enumerate(moments))
        images = images_of(stations, log.signals.images)
        plans.append(Plan(stations, log.wheels, tracks, images, tuple(log.rejections)))
    notes = [
        f"a piece of the recording between clock steps is not used: {e.message}" for e in problems.values()
    ]
    notes += (note for notes_of in (_silences, _blind, _not_used) for log in paired for note in notes_of(log))
    notes += dict.fromkeys(note for log in paired for note in _slow_wheels(log.channels[len(chain.joints) :]))
    if everything or rests < RESTS_ENOUGH:
        because = "all images are used" if everything else "too few"
        if everything and picked < moving:
            because = f"all images are asked for; of those in motion, {MOST_IN_MOTION}, evenly spread, fit into memory"
        stops = f"{capitalized(because)}. " if everything else ""
        if rests:
            stops = f"The robot rests {rests} time{'s' * (rests != 1)} with images ({because}). "
        used = (
            f"{picked} of {moving} images taken in motion are {'also ' * bool(stops)}used. Constant clock offsets are "
            "corrected (not by the methods linear, paper and lm)."
        )
        notes.append(f"{stops}{used if moving else ''}".rstrip())
        split = sum(log.split for log in paired)
        if split:
            notes.append(
                f"In motion, the images of {split} {shots_words(len(logs[0].images))} are more than "
                f"{1e3 * PAIR_MOVING_S:.0f} ms apart: they count one by one, which needs board.square_m. Trigger the "
                "cameras together."
            )
    return tuple(plans), tuple(notes)


def images_of(stations: Sequence[Station], images: Mapping[str, PictureIndex]) -> dict[str, PictureIndex]:
    """The images of some stations, of all that were recorded."""
    shots = [shot for station in stations for shot in station.shots]
    return {
        name: index.at([at for shot in shots if (at := shot.times_ns[k]) is not None])
        for k, (name, index) in enumerate(images.items())
    }
