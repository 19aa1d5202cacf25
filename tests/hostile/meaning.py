"""Recordings that can be read and are wrong: what the calibration says about each.

`python -m tests.hostile.meaning` prints the table in docs/validation/results.md.
"""

import re
import sys
from collections import Counter
from collections.abc import Callable
from dataclasses import dataclass, replace
from functools import cache

import numpy as np

from mobilecal_cli import se3
from mobilecal_cli.calibrate.gaps import require_stations
from mobilecal_cli.errors import MobilecalError, RecordingError
from mobilecal_cli.model.arrays import FloatArray
from mobilecal_cli.model.observations import Corners, Extraction, Observation, WheelTrack
from mobilecal_cli.model.rig import CameraRig, FixedLink, WheelGeometry
from mobilecal_cli.model.signals import Track
from mobilecal_cli.rig.cameras import BASELINE
from mobilecal_cli.simulate.robot import TICK_ROBOT
from mobilecal_cli.solvers import solve
from tests.extractions import Noise, joined, simulated
from tests.judging import judge
from tests.pairs import measured_anew, with_pair
from tests.robots import in_cameras
from tests.truth import errors

SIGMAS = 4.0
NOISE = Noise(pixel_px=0.1, wheel_rad_per_sqrt_rad=0.003, joint_rad=float(np.radians(0.02)))
STATIONS, HALF = 20, 10
PAN, TILT = 0, 1
OUTCOMES = (
    "refused, right cause",
    "refused, other cause",
    "FAIL, right cause",
    "FAIL, other cause",
    "NOT ENOUGH",
    "PASS, right",
    "PASS, wrong",
)
Change = Callable[[Extraction], Extraction]


@dataclass(frozen=True)
class Wrong:
    """One wrong recording.

    Attributes:
        change: makes it from a right one.
        cause: what the error or the verdict must name (regular expression).
        unseen: why such a recording cannot show the mistake; then PASS is expected.
    """

    change: Change
    cause: str
    unseen: str = ""


@cache
def recorded() -> Extraction:
    """A right recording."""
    return simulated("standard", NOISE, "tick", STATIONS, 4)


def wheels(right: Callable[[Track], Track], left: Callable[[Track], Track], swapped: bool = False) -> Change:
    """Change the tracks of both wheels."""

    def change(made: Extraction) -> Extraction:
        (track,) = made.wheels
        a, b = (track.left, track.right) if swapped else (track.right, track.left)
        return replace(made, wheels=(WheelTrack(right(a), left(b)),))

    return change


def both(change: Callable[[Track], Track]) -> Change:
    """Change the tracks of both wheels in the same way."""
    return wheels(change, change)


def same(track: Track) -> Track:
    """No change."""
    return track


def times(factor: float) -> Callable[[Track], Track]:
    """Readings in another unit, or with another sign."""
    return lambda track: replace(track, value=factor * track.value)


def late(seconds: float) -> Callable[[Track], Track]:
    """Readings with delayed stamps."""
    return lambda track: replace(track, time_ns=track.time_ns + round(seconds * 1e9))


def middle(track: Track, station: int = HALF, of: Callable[[], Extraction] = recorded) -> FloatArray:
    """(n,) which readings are after a station of a recording."""
    return np.asarray(track.time_ns > of().observations[station].time_ns)


def after(
    change: Callable[[FloatArray], FloatArray], station: int = HALF, of: Callable[[], Extraction] = recorded
) -> Callable[[Track], Track]:
    """Change the readings from a station on; the function receives the last value before as 0."""

    def changed(track: Track) -> Track:
        later = middle(track, station, of)
        start = track.value[~later][-1]
        return replace(track, value=np.where(later, start + change(track.value - start), track.value))

    return changed


def unsigned(track: Track) -> Track:
    """A counter that counts both directions up."""
    return replace(track, value=np.concatenate([[0.0], np.cumsum(np.abs(np.diff(track.value)))]))


def reset(track: Track) -> Track:
    """A counter that starts again at zero in the middle."""
    later = middle(track)
    return replace(track, value=np.where(later, track.value - track.value[~later][-1], track.value))


def loses(every: int) -> Callable[[Track], Track]:
    """A counter that misses one of so many steps."""
    return times(1 - 1 / every)


def joints(change: Callable[[FloatArray], FloatArray]) -> Change:
    """Change the joint readings of every station."""
    return stations(lambda n, o, _: replace(o, joints=change(o.joints)))


def joint(which: int, change: Callable[[float], float]) -> Change:
    """Change the reading of one joint."""

    def changed(q: FloatArray) -> FloatArray:
        q = q.copy()
        q[which] = change(float(q[which]))
        return q

    return joints(changed)


def late_joints(seconds: float) -> Change:
    """Joint readings with delayed stamps."""
    shift_ns = round(seconds * 1e9)

    def change(made: Extraction) -> Extraction:
        def read(o: Observation) -> FloatArray:
            before = np.array([o.time_ns - shift_ns])
            return np.array([track.at(before)[0] for track in made.joint_tracks[o.log]])

        observations = tuple(replace(o, joints=read(o)) for o in made.observations)
        tracks = (tuple(replace(t, time_ns=t.time_ns + shift_ns) for t in each) for each in made.joint_tracks)
        return replace(made, observations=observations, joint_tracks=tuple(tracks))

    return change


def stations(change: Callable[[int, Observation, tuple[Observation, ...]], Observation]) -> Change:
    """Change every station, with its index and all stations at hand."""
    return lambda made: replace(
        made,
        observations=tuple(change(n, o, made.observations) for n, o in enumerate(made.observations)),
        joint_tracks=(),
    )


def stuck(joint: int, station: int) -> Change:
    """A joint that is read no more from one station on."""

    def change(n: int, o: Observation, all_: tuple[Observation, ...]) -> Observation:
        kept = all_[min(n, station)].joints[joint]
        return replace(o, joints=np.where(np.arange(len(o.joints)) == joint, kept, o.joints))

    return stations(change)


def from_middle(change: Callable[[Observation], Observation]) -> Change:
    """Change the stations from the middle on."""
    return stations(lambda n, o, _: change(o) if n >= HALF else o)


def moved_board(rotvec_rad: tuple[float, float, float], shift_m: tuple[float, float, float]) -> Change:
    """A board that is moved in its own frame, in the middle of the recording."""
    T = se3.transform(se3.exp_so3(np.array(rotvec_rad)), np.array(shift_m))

    def change(o: Observation) -> Observation:
        moved = o.T_c_k @ T
        shift = moved @ se3.inverse(o.T_c_k)
        return replace(o, T_c_k=moved, points_c=se3.act(shift, o.points_c))

    def seen(made: Extraction) -> Extraction:
        rig = made.rig.cameras
        return measured(lambda n, o: pixels_of(o) if n < HALF else shown(rig, o.points_c))(
            from_middle(change)(made)
        )

    return seen


def pixels_of(o: Observation) -> tuple[FloatArray, FloatArray]:
    """The corners in both images, px."""
    return o.views[0].pixels, o.views[1].pixels


def shown(rig: CameraRig, points_c: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Where both cameras show points, px."""
    left, right = in_cameras(rig, np.eye(4), points_c)
    return left, right


def measured(pixels: Callable[[int, Observation], tuple[FloatArray, FloatArray]]) -> Change:
    """Other corners in the images, measured with the stated cameras."""
    return lambda made: _measured(made, made.rig.cameras, pixels)


def cameras(change: Callable[[CameraRig], CameraRig]) -> Change:
    """Other camera infos for the same images."""

    def changed(made: Extraction) -> Extraction:
        rig = change(made.rig.cameras)
        made = replace(made, rig=replace(made.rig, cameras=rig))
        return _measured(made, rig, lambda n, o: pixels_of(o))

    return changed


def _measured(
    made: Extraction, rig: CameraRig, pixels: Callable[[int, Observation], tuple[FloatArray, FloatArray]]
) -> Extraction:
    corners_k = made.board.grid() * (made.board.square_m or made.observations[0].square_m)
    found = []
    for n, o in enumerate(made.observations):
        both = (Corners(at, v.sigma_px, 1) for at, v in zip(pixels(n, o), o.views, strict=True))
        found.append(measured_anew(rig, o, corners_k, *both))
    kept = tuple(o for o in found if o is not None)
    return replace(made, observations=kept, joint_tracks=())


def focal(left: float, right: float) -> Change:
    """Focal lengths in the infos, times the true ones."""

    def change(rig: CameraRig) -> CameraRig:
        of_pair = zip(rig.each, (left, right), strict=True)
        return with_pair(rig, *(replace(c, K=c.K * (1 + (x - 1) * np.diag([1, 1, 0]))) for c, x in of_pair))

    return cameras(change)


def shifted(left: tuple[float, float], right: tuple[float, float]) -> Change:
    """Images shifted by some pixels, as by a wrong region of interest."""
    return measured(lambda n, o: (o.views[0].pixels + np.array(left), o.views[1].pixels + np.array(right)))


def baseline(factor: float) -> Change:
    """A baseline in the infos, times the true one."""

    def change(rig: CameraRig) -> CameraRig:
        T = rig.T_c_each[1].copy()
        T[:3, 3] *= factor
        if np.linalg.norm(T[:3, 3]) not in BASELINE:
            raise RecordingError("the stereo baseline is not possible", "")
        return with_pair(rig, T_c_r=T)

    return cameras(change)


def exchanged_infos(rig: CameraRig) -> CameraRig:
    """The infos of both cameras exchanged, with their frames in place."""
    left, right = rig.each[0], rig.each[1]
    exchanged = {
        "left": replace(right, frame_id=left.frame_id),
        "right": replace(left, frame_id=right.frame_id),
    }
    return with_pair(rig, **exchanged)


def square(factor: float) -> Change:
    """A stated square, times the true one."""

    def change(made: Extraction) -> Extraction:
        board = replace(made.board, square_m=factor * (made.board.square_m or 0.0))
        made = replace(made, board=board)
        return _measured(made, made.rig.cameras, lambda n, o: pixels_of(o))

    return change


def chain_offset(shift_m: tuple[float, float, float]) -> Change:
    """A URDF whose head is mounted elsewhere."""
    link = FixedLink(se3.transform(np.eye(3), np.array(shift_m)))

    def change(made: Extraction) -> Extraction:
        chain = replace(made.rig.chain, links=(link, *made.rig.chain.links))
        return replace(made, rig=replace(made.rig, chain=chain))

    return change


def turned_axis(which: int, angle_rad: float) -> Change:
    """A URDF in which the axis of a joint is turned."""
    R = se3.exp_so3(np.array([angle_rad, 0.0, 0.0]))

    def change(made: Extraction) -> Extraction:
        links, name = [], made.rig.chain.joints[which]
        for link in made.rig.chain.links:
            turn = not isinstance(link, FixedLink) and link.joint == name
            links.append(replace(link, axis=R @ link.axis) if turn else link)
        return replace(made, rig=replace(made.rig, chain=replace(made.rig.chain, links=tuple(links))))

    return change


def nominal_wheels(radius: float, separation: float) -> Change:
    """A URDF with other wheels."""

    def change(made: Extraction) -> Extraction:
        was = made.rig.nominal.wheels
        assert was is not None
        new = WheelGeometry.of(was.vector * [radius, radius, separation])
        nominal = replace(made.rig.nominal, wheels=new)
        return replace(made, rig=replace(made.rig, nominal=nominal))

    return change


def old_images(left: bool, right: bool, frozen: bool) -> Change:
    """Images of the previous station, or of the one in the middle from there on (frozen)."""

    def change(made: Extraction) -> Extraction:
        seen = made.observations

        def source(n: int) -> Observation:
            return seen[min(n, HALF)] if frozen else seen[max(n - 1, 0)]

        def pixels(n: int, o: Observation) -> tuple[FloatArray, FloatArray]:
            old, new = pixels_of(source(n)), pixels_of(o)
            return old[0] if left else new[0], old[1] if right else new[1]

        return measured(pixels)(made)

    return change


def spikes(every: int, value_rad: float) -> Callable[[Track], Track]:
    """One reading of so many is far off."""

    def changed(track: Track) -> Track:
        value = track.value.copy()
        value[every // 2 :: every] += value_rad
        return replace(track, value=value)

    return changed


def silent(track: Track) -> Track:
    """No readings between two stations in the middle, while the base drives."""
    seen = recorded().observations
    off = (track.time_ns > seen[HALF].time_ns) & (track.time_ns < seen[HALF + 1].time_ns)
    return Track(track.time_ns[~off], track.value[~off])


def quantized(step_rad: float) -> Callable[[Track], Track]:
    """A counter with coarse steps."""
    return lambda track: replace(track, value=np.round(track.value / step_rad) * step_rad)


def backwards(track: Track) -> Track:
    """The readings in the reverse order."""
    return replace(track, value=track.value[::-1])


def other_drive(track: Track) -> Track:
    """The readings of another recording."""
    other = simulated("standard", NOISE, "tick", STATIONS, 9).wheels[0].right
    value = np.interp(np.arange(len(track.value)), np.arange(len(other.value)), other.value)
    return replace(track, value=value)


def one_wheel(made: Extraction) -> Extraction:
    """Both wheels read from one encoder."""
    (track,) = made.wheels
    return replace(made, wheels=(WheelTrack(track.right, track.right),))


def drifting(made: Extraction) -> Extraction:
    """The zero of pan moves by 0.1 rad over the recording."""
    shift = np.linspace(0.0, 0.1, len(made.observations))
    return stations(lambda n, o, _: replace(o, joints=o.joints + np.array([shift[n], 0.0])))(made)


def shuffled(made: Extraction) -> Extraction:
    """Joint readings of other stations."""
    order = np.random.default_rng(3).permutation(len(made.observations))
    return stations(lambda n, o, all_: replace(o, joints=all_[order[n]].joints))(made)


def turned_board(made: Extraction) -> Extraction:
    """A board upside down from the middle on, on the same place."""
    width, height, _ = (made.board.grid()[-1] * (made.board.square_m or 1.0)).tolist()
    return moved_board((0, 0, np.pi), (width, height, 0))(made)


def board_in_hand(made: Extraction) -> Extraction:
    """Somebody holds the board: it moves by centimeters between the stations."""
    random = np.random.default_rng(8)

    def moved(n: int, o: Observation) -> tuple[FloatArray, FloatArray]:
        T = se3.transform(se3.exp_so3(random.normal(size=3) * 0.03), random.normal(size=3) * 0.03)
        return shown(made.rig.cameras, se3.act(o.T_c_k @ T @ se3.inverse(o.T_c_k), o.points_c))

    return _measured(made, made.rig.cameras, moved)


def board_on_the_robot(made: Extraction) -> Extraction:
    """All stations show the board where the first one does."""
    return measured(lambda n, o: pixels_of(made.observations[0]))(made)


def stretched(factor: float) -> Change:
    """A board printed wider than stated."""

    def change(made: Extraction) -> Extraction:
        grid = made.board.grid() * (made.board.square_m or 1.0) * np.array([factor, 1.0, 1.0])
        return measured(lambda n, o: shown(made.rig.cameras, se3.act(o.T_c_k, grid)))(made)

    return change


def no_distortion(rig: CameraRig) -> CameraRig:
    """Infos without the distortion that the lenses have."""
    left, right = (replace(camera, D=np.zeros_like(camera.D)) for camera in (rig.each[0], rig.each[1]))
    return with_pair(rig, left=left, right=right)


def swapped_stations(made: Extraction) -> Extraction:
    """The images of two stations exchanged."""
    a, b = 5, 14
    return measured(lambda n, o: pixels_of(made.observations[{a: b, b: a}.get(n, n)]))(made)


def another_robot(made: Extraction) -> Extraction:
    """A second recording, of a robot with other wheels and another camera."""
    robot = TICK_ROBOT
    wheels_ = WheelGeometry(*(robot.wheels.vector * [1.1, 1.1, 1.05]))
    T = robot.T_h_c @ se3.transform(se3.exp_so3(np.array([0.05, 0.0, 0.05])), np.array([0.02, 0.0, 0.01]))
    other = replace(robot, wheels=wheels_, T_h_c=T)
    second = simulated("standard", NOISE, other, STATIONS, 7)
    return replace(joined(made, second), joint_tracks=())


_WIDTH, _HEIGHT = 639.0, 479.0
_WHEELS = "wheel|driv|dead reckoning|slip|leg"
_TIME = "clock|late|time|stamp|wheel|slip|leg|station"
_CAMERA = "stereo|camera|focal|principal|baseline|image|epipolar|reprojection|calibrat"
_BOARD = "board|station|move|square"
_SCALE = "square|baseline|scale|focal"
WRONG: dict[str, Wrong] = {
    "sign of the right wheel": Wrong(wheels(times(-1), same), "right wheel's encoder has the wrong sign"),
    "sign of the left wheel": Wrong(wheels(same, times(-1)), "left wheel's encoder has the wrong sign"),
    "signs of both wheels": Wrong(both(times(-1)), "wrong sign"),
    "wheels swapped": Wrong(wheels(same, same, swapped=True), "wheels are swapped"),
    "wheels swapped, one with a wrong sign": Wrong(wheels(times(-1), same, swapped=True), "swapped|sign"),
    "wheels swapped, both with wrong signs": Wrong(wheels(times(-1), times(-1), swapped=True), "swapped|sign"),
    "wheels in degrees": Wrong(both(times(57.29578)), "wheel radi|degrees"),
    "wheels in turns": Wrong(both(times(1 / (2 * np.pi))), "wheel radi|turns"),
    "gear ratio 2 of both wheels": Wrong(both(times(2.0)), "half of the nominal"),
    "gear ratio 1/2 of both wheels": Wrong(both(times(0.5)), "twice the nominal"),
    "gear ratio 2 of the right wheel": Wrong(wheels(times(2.0), same), "right wheel|radii differ"),
    "right wheel 10 % off": Wrong(wheels(times(1.1), same), "", "a wheel of another radius reads the same"),
    "left wheel misses one of 50 steps": Wrong(wheels(same, loses(50)), "", "a wheel of another radius reads the same"),
    "right wheel frozen": Wrong(wheels(times(0.0), same), "right wheel"),
    "left wheel frozen": Wrong(wheels(same, times(0.0)), "left wheel"),
    "both wheels frozen": Wrong(both(times(0.0)), "wheel|did not move|motion"),
    "right wheel frozen from the middle": Wrong(wheels(after(lambda v: 0 * v), same), "right wheel"),
    "both wheels frozen from the middle": Wrong(both(after(lambda v: 0 * v)), _WHEELS),
    "right wheel twice as fast from the middle": Wrong(wheels(after(lambda v: 2 * v), same), _WHEELS),
    "right wheel reversed from the middle": Wrong(wheels(after(lambda v: -v), same), "right wheel"),
    "both wheels 10 % faster from the middle": Wrong(both(after(lambda v: 1.1 * v)), _WHEELS),
    "both counters start again": Wrong(both(reset), _WHEELS),
    "right wheel jumps by 3 rad": Wrong(wheels(after(lambda v: v + 3.0), same), _WHEELS),
    "right wheel jumps by one turn": Wrong(wheels(after(lambda v: v + 2 * np.pi), same), _WHEELS),
    "wheels 0.3 s late": Wrong(both(late(0.3)), "", "stops last longer than the delay"),
    "wheels 3 s late": Wrong(both(late(3.0)), _TIME),
    "wheels 10 s late": Wrong(both(late(10.0)), _TIME),
    "right wheel 3 s late": Wrong(wheels(late(3.0), same), _TIME),
    "sign of pan": Wrong(joint(PAN, lambda q: -q), "pan_joint is reversed"),
    "sign of tilt": Wrong(joint(TILT, lambda q: -q), "tilt_joint is reversed"),
    "signs of both joints": Wrong(joints(lambda q: -q), "all head joints are reversed"),
    "pan and tilt exchanged": Wrong(joints(lambda q: q[::-1]), "exchanged"),
    "joints in degrees": Wrong(joints(np.degrees), "in degrees"),
    "joints taken for degrees": Wrong(joints(np.radians), "in radians"),
    "pan in degrees": Wrong(joint(PAN, lambda q: float(np.degrees(q))), "degrees|pan_joint"),
    "pan 10 % off": Wrong(joint(PAN, lambda q: 1.1 * q), "pan_joint"),
    "tilt 20 % off": Wrong(joint(TILT, lambda q: 1.2 * q), "tilt_joint"),
    "pan 0.2 rad off": Wrong(joint(PAN, lambda q: q + 0.2), "pan_joint"),
    "tilt 0.2 rad off": Wrong(joint(TILT, lambda q: q + 0.2), "", "it is a rotation of the camera on the head"),
    "pan frozen": Wrong(joint(PAN, lambda q: 0.1), "pan_joint never changes"),
    "tilt frozen": Wrong(joint(TILT, lambda q: 0.1), "tilt_joint never changes"),
    "pan frozen from the middle": Wrong(stuck(PAN, HALF), "pan_joint does not change"),
    "joints of the previous station": Wrong(
        stations(lambda n, o, all_: replace(o, joints=all_[max(n - 1, 0)].joints)), "joint|time|clock|station"
    ),
    "pan 0.1 rad off from the middle": Wrong(from_middle(lambda o: replace(o, joints=o.joints + np.array([0.1, 0.0]))), "joint|station|pan"),
    "pan is the sum of pan and tilt": Wrong(joints(lambda q: np.array([q.sum(), q[1]])), "joint|axis|axes"),
    "images of left and right exchanged": Wrong(measured(lambda n, o: (o.views[1].pixels, o.views[0].pixels)), _CAMERA),
    "infos of left and right exchanged": Wrong(cameras(exchanged_infos), _CAMERA + "|solutions"),
    "focal lengths 3 % off": Wrong(focal(1.03, 1.03), _SCALE),
    "focal lengths 10 % off": Wrong(focal(1.1, 1.1), _SCALE),
    "left focal length 3 % off": Wrong(focal(1.03, 1.0), _CAMERA),
    "focal lengths of half the resolution": Wrong(focal(0.5, 0.5), _SCALE + "|camera_info"),
    "left image shifted by 20 px": Wrong(shifted((20.0, 0.0), (0.0, 0.0)), _CAMERA),
    "left image lowered by 20 px": Wrong(shifted((0.0, 20.0), (0.0, 0.0)), _CAMERA),  # the corners' gates see it
    "both images shifted by 20 px": Wrong(shifted((20.0, 0.0), (20.0, 0.0)), _CAMERA),
    "both images lowered by 20 px": Wrong(shifted((0.0, 20.0), (0.0, 20.0)), _CAMERA),
    "images mirrored": Wrong(
        measured(lambda n, o: tuple(np.array([_WIDTH, 0.0]) - p * [1, -1] for p in pixels_of(o))),  # type: ignore[arg-type, return-value]
        _CAMERA,
    ),
    "images upside down": Wrong(
        measured(lambda n, o: tuple(np.array([_WIDTH, _HEIGHT]) - p for p in pixels_of(o))),  # type: ignore[arg-type, return-value]
        _CAMERA,
    ),
    "baseline 1 % off": Wrong(baseline(1.01), _SCALE),
    "baseline 10 % off": Wrong(baseline(1.1), _SCALE),
    "baseline in centimeters": Wrong(baseline(100.0), _SCALE),
    "square 1 % off": Wrong(square(1.01), _SCALE),
    "square 10 % off": Wrong(square(1.1), _SCALE),
    "square in inches": Wrong(square(0.3937), _SCALE),
    "left images frozen from the middle": Wrong(old_images(True, False, True), _CAMERA + "|station"),
    "both images frozen from the middle": Wrong(old_images(True, True, True), _TIME),
    "right images of the previous station": Wrong(old_images(False, True, False), _CAMERA + "|station"),
    "both images of the previous station": Wrong(old_images(True, True, False), _TIME),
    "board 3 cm to the side from the middle": Wrong(moved_board((0, 0, 0), (0.03, 0, 0)), _BOARD),
    "board 3 cm lower from the middle": Wrong(moved_board((0, 0, 0), (0, 0.03, 0)), _BOARD),
    "board 10 cm nearer from the middle": Wrong(moved_board((0, 0, 0), (0, 0, -0.1)), _BOARD),
    "board turned by 5 degrees from the middle": Wrong(moved_board((0, 0, 0.087), (0, 0, 0)), _BOARD),
    "board tilted by 5 degrees from the middle": Wrong(moved_board((0.087, 0, 0), (0, 0, 0)), _BOARD),
    "wheels in meters": Wrong(both(times(0.082)), "readings are in meters"),
    "wheels before a gear of 30": Wrong(both(times(30.0)), "wheel radi"),
    "right wheel in degrees": Wrong(wheels(times(57.29578), same), "right wheel|radii differ"),
    "both wheels from one encoder": Wrong(one_wheel, "wheel|turn"),
    "wheels wrapped at one turn": Wrong(both(lambda track: replace(track, value=np.mod(track.value, 2 * np.pi))), _WHEELS),
    "right wheel wrapped at one turn": Wrong(wheels(lambda track: replace(track, value=np.mod(track.value, 2 * np.pi)), same), _WHEELS),
    "every 50th wheel reading 5 rad off": Wrong(both(spikes(50, 5.0)), _WHEELS),
    "every 500th wheel reading 5 rad off": Wrong(both(spikes(500, 5.0)), _WHEELS),
    "wheel readings stop and start again": Wrong(both(silent), _WHEELS),
    "right wheel in steps of 1 rad": Wrong(wheels(quantized(1.0), same), _WHEELS),
    "wheel readings backwards": Wrong(both(backwards), _WHEELS),
    "wheels of another drive": Wrong(both(other_drive), _WHEELS),
    "right wheel of another drive": Wrong(wheels(other_drive, same), _WHEELS),
    "wheels an hour late": Wrong(both(late(3600.0)), _TIME + "|never change"),
    "left wheel twice as fast from the middle": Wrong(wheels(same, after(lambda v: 2 * v)), "left wheel"),
    "pan and tilt exchanged from the middle": Wrong(from_middle(lambda o: replace(o, joints=o.joints[::-1])), "joint|pan|station"),
    "joints in degrees from the middle": Wrong(from_middle(lambda o: replace(o, joints=np.degrees(o.joints))), "joint|degrees|station"),
    "sign of pan from the middle": Wrong(from_middle(lambda o: replace(o, joints=o.joints * np.array([-1.0, 1.0]))), "joint|pan|station"),
    "joints of other stations": Wrong(shuffled, "joint|station|time"),
    "zero of pan drifts by 0.1 rad": Wrong(drifting, "pan|joint|station"),
    "joints in steps of 5 degrees": Wrong(joints(lambda q: np.radians(np.round(np.degrees(q) / 5) * 5)), "joint"),
    "pan wrapped by one turn from the middle": Wrong(from_middle(lambda o: replace(o, joints=o.joints + np.array([2 * np.pi, 0.0]))), "pan"),
    "board upside down from the middle": Wrong(turned_board, _BOARD),
    "board held in a hand": Wrong(board_in_hand, _BOARD),
    "board on the robot": Wrong(board_on_the_robot, _BOARD + "|head|wheel|did not move"),
    "board 3 % wider than high": Wrong(stretched(1.03), "squares|board|height"),
    "images of two stations exchanged": Wrong(swapped_stations, "station"),
    "right images of the next station": Wrong(measured(lambda n, o: (o.views[0].pixels, recorded().observations[min(n + 1, STATIONS - 1)].views[1].pixels)), _CAMERA + "|station"),
    "left images upside down": Wrong(measured(lambda n, o: (np.array([_WIDTH, _HEIGHT]) - o.views[0].pixels, o.views[1].pixels)), _CAMERA),
    "images of half the resolution": Wrong(measured(lambda n, o: (0.5 * o.views[0].pixels, 0.5 * o.views[1].pixels)), _SCALE + "|camera"),
    "left images of half the resolution": Wrong(measured(lambda n, o: (0.5 * o.views[0].pixels, o.views[1].pixels)), _SCALE + "|camera"),
    "infos without the distortion": Wrong(cameras(no_distortion), _CAMERA + "|distortion"),
    "left info of another camera": Wrong(cameras(lambda rig: with_pair(rig, left=replace(rig.each[0], K=rig.each[0].K * np.array([[0.8, 1, 1.1], [1, 0.8, 0.9], [1, 1, 1]])))), _CAMERA),
    "a second recording of another robot": Wrong(another_robot, "recording|robot"),
    "pan axis upside down in the URDF": Wrong(turned_axis(PAN, np.pi), "pan_joint is reversed|all head joints"),
    "head mounted 10 cm higher": Wrong(chain_offset((0.0, 0.0, 0.1)), "", "a drive on a floor does not show the height"),
    "head mounted 10 cm further to the front": Wrong(chain_offset((0.1, 0.0, 0.0)), "chain|joint|position|mount"),
    "pan axis turned by 10 degrees": Wrong(turned_axis(PAN, 0.175), "axis|pan_joint"),
    "tilt axis turned by 10 degrees": Wrong(turned_axis(TILT, 0.175), "axis|tilt_joint"),
    "counters without a direction": Wrong(both(unsigned), "never decrease"),
    "counters of 32 bits wrap in the middle": Wrong(both(after(lambda v: v + 2**32 * 2 * np.pi / 4096)), "jump"),
    "right wheel 2 % larger from the middle": Wrong(wheels(after(lambda v: 1.02 * v), same), "right wheel"),
    "right wheel 5 % larger from the middle": Wrong(wheels(after(lambda v: 1.05 * v), same), "right wheel"),
    "joints 2 s late": Wrong(late_joints(2.0), "joint readings are about 2"),
    "pan 3 degrees off from the middle": Wrong(from_middle(lambda o: replace(o, joints=o.joints + np.radians([3.0, 0.0]))), "pan_joint"),
    "right images shifted by 15 px from the middle": Wrong(
        measured(lambda n, o: (o.views[0].pixels, o.views[1].pixels + np.array([15.0, 0.0]) * (n >= HALF))), _CAMERA
    ),
    "focal lengths 1 % off": Wrong(focal(1.01, 1.01), _SCALE),
    "nominal wheels twice as large": Wrong(nominal_wheels(2.0, 1.0), "half of the nominal"),
    "nominal separation 20 % too large": Wrong(nominal_wheels(1.0, 1.2), "", "the motion determines the separation"),
}  # fmt: skip


@dataclass(frozen=True)
class Outcome:
    """What was said.

    Attributes:
        kind: one of `OUTCOMES`.
        message: the error, or the reason of the verdict.
        sigmas: largest error of the nine parameters, in stated standard deviations; None without a result.
    """

    kind: str
    message: str
    sigmas: float | None = None


def outcome(name: str) -> Outcome:
    """Calibrate one wrong recording."""
    case, robot = WRONG[name], TICK_ROBOT
    try:
        made = case.change(recorded())
        require_stations(made)
        solution = solve(made)
    except MobilecalError as error:
        return Outcome(f"refused, {_cause(case, error.message)}", error.message)
    assert solution.uncertainty is not None
    verdict = judge(solution, made)
    worst = float(np.max(np.abs(errors(solution.parameters, robot)) / solution.uncertainty.std))
    if verdict.level == "PASS":
        return Outcome("PASS, right" if worst <= SIGMAS else "PASS, wrong", verdict.reason, worst)
    if verdict.level == "NOT ENOUGH":
        return Outcome("NOT ENOUGH", verdict.reason, worst)
    return Outcome(f"FAIL, {_cause(case, verdict.reason)}", verdict.reason, worst)


def _cause(case: Wrong, message: str) -> str:
    named = case.cause and re.search(case.cause, message, re.IGNORECASE)
    return "right cause" if named and "no known mistake" not in message else "other cause"


def main() -> None:
    """Print the table, and the counts."""
    counts: Counter[str] = Counter()
    print("| recording | outcome | largest error, sigma | message |\n| --- | --- | --- | --- |")
    for name in WRONG if len(sys.argv) < 2 else sys.argv[1:]:
        found = outcome(name)
        counts[found.kind] += 1
        sigmas = "" if found.sigmas is None else f"{found.sigmas:.1f}"
        print(f"| {name} | {found.kind} | {sigmas} | {found.message[:110].replace('|', '/')} |", flush=True)
    print(", ".join(f"{kind}: {counts[kind]}" for kind in OUTCOMES), f"of {sum(counts.values())}")


if __name__ == "__main__":
    main()
