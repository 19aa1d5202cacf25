"""Constants of the robot that are estimated beside the nine parameters, each with a prior around its stated value.

`KINDS` has the default priors, and `table` makes one row for each constant of the cameras, the board and the clocks. A
row names what its constant changes, an effect (see `effects`). The rows of the head's joints follow from the chain.
"""

from __future__ import annotations

import math
from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import cached_property, partial
from typing import Any, Literal, TypeVar

import numpy as np

from mobilecal_cli.likelihood.effects import (
    BaseLean,
    BoardEffect,
    CameraChange,
    CameraEffect,
    ChainChange,
    ChainEffect,
    Clock,
    Effect,
    FloorDrift,
    FloorShape,
    ImageEffect,
    JointReading,
    WheelDelay,
    WheelSmoothing,
    Widening,
    bent,
    resized,
    sheared,
    twisted,
)
from mobilecal_cli.model.arrays import FloatArray
from mobilecal_cli.model.calibration import NINE
from mobilecal_cli.model.rig import SIDES, CameraRig, HeadChain, JointLink, WheelGeometry, camera_words

# Prior sigmas of the nine: what a drawing or a ruler gives without any recording.
NINE_SIGMAS = np.array([0.2, 0.2, 0.2, 0.1, 0.1, 0.1])  # rad, m; wheels: a share of their size
WHEEL_SIGMA = 0.2
#: A recording of no more stations says nothing of its floor: two numbers take up what the legs between them show.
FEW_PLACES = 3
#: A constant that the user frees has so many times its default prior sigma.
FREED_SIGMAS = 100.0


@dataclass(frozen=True, slots=True)
class Kind:
    """What constants of one kind are, and how well a description usually states them.

    Attributes:
        name: as `priors:` in rig.yaml, `--estimate` and `--prior` take it.
        unit: of the values in the code: "s", "rad", "m", or "1" for a ratio (of the image width for pixels).
        shown_unit, shown: unit for people, and how many of it one `unit` is.
        sigma: default prior standard deviation, in `unit`.
        meaning: in words.
        names: pattern of the names of its constants that depend on the robot.
    """

    name: str
    unit: str
    shown_unit: str
    shown: float
    sigma: float
    meaning: str
    names: str = ""


_DEGREE = math.pi / 180
# Units in the code and for people, and how many of these it is.
_TIME, _LENGTH, _ANGLE = ("s", "ms", 1e3), ("m", "mm", 1e3), ("rad", "deg", 1 / _DEGREE)
_SHARE, _OF_WIDTH = ("1", "%", 100), ("1", "% of the image width", 100)
# fmt: off
KINDS: tuple[Kind, ...] = (
    Kind("clock", *_TIME, 0.2, "offset of a clock against the cameras' clock", r"time_(joints|wheels)_\d+"),
    Kind("stereo_clock", *_TIME, 0.002, "delay of a camera against the first one",
         r"time_(?!(joints|wheels)_\d+$).+"),
    Kind("readout", *_TIME, 0.0005, "time between the first and the last row of an image"),
    Kind("focal_length", *_SHARE, 0.002, "focal length of a camera", r"focal_.+"),
    Kind("focal_aspect", *_SHARE, 0.001, "horizontal focal length of a camera against the vertical one",
         r"focal_aspect_.+"),
    Kind("principal_point", *_OF_WIDTH, 0.003, "principal point of a camera", r"principal_.+_[xy]"),
    Kind("distortion", *_OF_WIDTH, 0.0008, "distortion of a camera, at the image corner",
         r"distortion_.+_(radial|tangential)_[12xy]"),
    Kind("lens_waves", *_OF_WIDTH, 0.0002, "what a lens does beside its distortion, rms",
         r"lens_waves_.+_\d+"),
    Kind("stereo_rotation", *_ANGLE, 0.05 * _DEGREE, "rotation between the two cameras"),
    Kind("baseline_direction", *_ANGLE, 0.1 * _DEGREE, "direction of the stereo baseline", r"baseline_[xyz]"),
    Kind("baseline_length", *_SHARE, 0.002, "length of the stereo baseline"),
    Kind("camera_rotation", *_ANGLE, 1.0 * _DEGREE, "rotation of a camera against the first",
         r"turn_.+_[xyz]"),
    Kind("camera_position", *_LENGTH, 0.005, "position of a camera against the first", r"shift_.+_[xyz]"),
    Kind("square_size", *_SHARE, 0.001, "size of the board's squares"),
    Kind("square_aspect", *_SHARE, 0.001, "width of the board's squares against their height"),
    Kind("board_bend", *_LENGTH, 0.0005, "bend of the board"),
    Kind("board_shear", *_ANGLE, 0.05 * _DEGREE, "angle between the board's rows and columns"),
    Kind("board_corners", *_LENGTH, 0.00015, "place of a corner on the board (across it, twice as much)"),
    Kind("lean", *_ANGLE, 0.05 * _DEGREE, "lean of the base against the floor's normal"),
    Kind("floor_shape", *_LENGTH, 0.001, "deviation of the floor from a plane, 1 m from the first station",
         r"floor_[xy]+(_\d+)?"),
    Kind("joint_zero", *_ANGLE, 0.5 * _DEGREE, "zero position of a head joint", r".+_zero"),
    Kind("joint_scale", *_SHARE, 0.001, "scale of a head joint's reading", r".+_scale"),
    Kind("joint_axis", *_ANGLE, 0.1 * _DEGREE, "direction of a head joint's axis", r".+_axis_[xyz]"),
    Kind("joint_position", *_LENGTH, 0.001, "position of a head joint's axis", r".+_position_[xyz]"),
    Kind("floor_drift", *_LENGTH, 0.001, "drift of the base over the floor, per meter of wheel travel",
         r"drift_[xy](_\d+)?"),
    Kind("turn_slip", *_SHARE, 0.03, "effective wheel separation at twice the mean turning rate (four wheels)"),
    Kind("turn_sides", *_SHARE, 0.002, "effective wheel separation in left turns against the mean of all turns"),
    Kind("wheel_delay", *_TIME, 0.001, "delay of the right wheel's readings against the left one's"),
    Kind("wheel_smoothing", "s^2", "ms^2", 1e6, 5e-4, "filter of the wheels' readings (time constant squared)"),
    Kind("backlash", *_ANGLE, 0.1 * _DEGREE, "backlash of a head joint", r"backlash_.+"),
)
# fmt: on
#: Group, as --estimate takes it → its kinds; those of the head depend on its joints, the others on the cameras.
KIND_GROUPS = {
    "stereo": ("stereo_rotation", "baseline_direction", "baseline_length"),
    "lenses": ("focal_length", "focal_aspect", "principal_point", "distortion", "lens_waves"),
    "board": ("square_size", "square_aspect", "board_bend", "board_shear", "board_corners"),
    "head": ("joint_zero", "joint_scale", "joint_axis", "joint_position", "backlash"),
}
_BY_NAME = {kind.name: kind for kind in KINDS}
_TOGETHER = {"baseline_length": "square_size"}
#: Kinds that no description states: no data contradict them.
UNSTATED = frozenset({"board_corners", "floor_drift", "floor_shape", "lens_waves"})
#: Kinds whose expected value is assumed where nobody states it: what the data show instead is no fault of the robot.
ASSUMED = frozenset({"readout", "wheel_smoothing"})
#: Kinds of errors of many numbers, see `patterns`: estimated, but never part of an exported camera or board.
PATTERNS = frozenset({"board_corners", "lens_waves"})
#: Kinds of which each recording has rows of its own, beside those of `table`.
OF_RECORDINGS = UNSTATED | {"clock"}
#: Kinds that others are judged with, see `family`: what all constants of one share does not show.
FAMILIES = frozenset(_TOGETHER.values())


def kind_of(name: str) -> Kind:
    """The row of a kind.

    Raises:
        KeyError: there is none of this name.
    """
    return _BY_NAME[name]


def family(name: str) -> str:
    """The kind that a kind is judged with: only the ratio of the squares' size and the baseline shows."""
    return _TOGETHER.get(name, name)


@dataclass(frozen=True, slots=True)
class Constant:
    """A constant that may be estimated beside the nine parameters: its difference from the stated value.

    Attributes:
        name: as `--fix` and `--prior` take it.
        kind: name of its kind.
        part: the part of the robot that it belongs to, in words.
        meaning: in words.
        effect: what it changes.
        sigma: prior standard deviation, in the kind's unit; the expected value is zero.
    """

    name: str
    kind: str
    part: str
    meaning: str
    effect: Effect
    sigma: float

    @property
    def of_kind(self) -> Kind:
        """The row of its kind."""
        return _BY_NAME[self.kind]


def _row(name: str, kind: str, part: str, meaning: str, effect: Effect, unit: float = 1.0) -> Constant:
    """The row with the kind's prior; `unit`: of a joint whose unit is not 1 rad."""
    return Constant(name, kind, part, meaning, effect, _BY_NAME[kind].sigma * unit)


_NARROWER = partial(resized, x=0.5, y=-0.5)
_SHAPES = (
    ("square_scale", "square_size", "size of the squares", partial(resized, x=1.0, y=1.0)),
    ("square_aspect", "square_aspect", "width of the squares against their height", _NARROWER),
    ("board_bend_x", "board_bend", "bend along x", partial(bent, axis=0)),
    ("board_bend_y", "board_bend", "bend along y", partial(bent, axis=1)),
    ("board_twist", "board_bend", "twist", twisted),
    ("board_shear", "board_shear", "angle between rows and columns, less 90 degrees", sheared),
)
_LETTERS = "xyz"
# Powers of x and y in the shape of a floor beside its plane; what is left of a smooth floor varies along the way.
_FLOOR_POWERS = tuple((a, degree - a) for degree in (2, 3) for a in range(degree, -1, -1))
_CLOCKS: tuple[tuple[Literal["joints", "wheels"], str], ...] = (("joints", "joint"), ("wheels", "wheel"))


_AXES = (("x", (1.0, 0.0, 0.0)), ("y", (0.0, 1.0, 0.0)), ("z", (0.0, 0.0, 1.0)))
_Rows = Sequence[Sequence[tuple[str, str, str, str, tuple[float, ...]]]]
# Rows of each camera: name (with the camera's), kind, meaning (with the first camera), attribute of `CameraChange` and
# vector that a value of one adds to it. The rows of one property of all cameras stand together.
# fmt: off
_OF_CAMERAS: _Rows = (
    (("focal_{}", "focal_length", "focal length", "focal", (1.0, 1.0)),),
    (("focal_aspect_{}", "focal_aspect", "fx against fy", "focal", (0.5, -0.5)),),
    (("principal_{}_x", "principal_point", "principal point, x", "principal", (1.0, 0.0)),
     ("principal_{}_y", "principal_point", "principal point, y", "principal", (0.0, 1.0))),
    (("distortion_{}_radial_1", "distortion", "radial distortion, third order", "lens", (1.0, 0.0, 0.0, 0.0)),
     ("distortion_{}_radial_2", "distortion", "radial distortion, fifth order", "lens", (0.0, 1.0, 0.0, 0.0)),
     ("distortion_{}_tangential_x", "distortion", "tangential distortion, x", "lens", (0.0, 0.0, 1.0, 0.0)),
     ("distortion_{}_tangential_y", "distortion", "tangential distortion, y", "lens", (0.0, 0.0, 0.0, 1.0))),
)
# Of the poses of the others in the first: calibrated (without the direction of the baseline), and as described.
_CALIBRATED: _Rows = ([(f"stereo_r_{x}", "stereo_rotation", f"rotation about the {{}}'s {x}", "turn", e)
                       for x, e in _AXES],)
_DESCRIBED: _Rows = ([(f"{of}_{{}}_{x}", kind, f"{word} the {{}}'s {x}", of, e)
                      for of, kind, word in (("turn", "camera_rotation", "rotation about"),
                                             ("shift", "camera_position", "position along")) for x, e in _AXES],)
_DELAYS: _Rows = ([("time_{}", "stereo_clock", "delay against the {}", "delay_s", (1.0,))],)
# fmt: on


def _of_cameras(rows: _Rows, names: Sequence[str], but: int = 0) -> Iterator[Constant]:
    """Rows for all cameras but so many first ones."""
    for of_property in rows:
        for k, camera in enumerate(names[but:], but):
            for name, kind, meaning, of, along in of_property:
                words = camera_words(camera), meaning.format(camera_words(names[0]))
                yield _row(name.format(camera), kind, *words, CameraEffect(of, along, k))


def _common(names: Sequence[str], calibrated: bool) -> tuple[Constant, ...]:
    """Rows that do not depend on the geometry of the robot."""
    first = camera_words(names[0])
    every = f"{'both' if len(names) == 2 else 'all'} cameras" if len(names) > 1 else first
    # fmt: off
    return (
        _row("time_joints", "clock", "joints", "joint clock minus camera clock", Clock("joints")),
        _row("time_wheels", "clock", "wheels", "wheel clock minus camera clock", Clock("wheels")),
        *_of_cameras(_OF_CAMERAS, names),
        *_of_cameras(_CALIBRATED if calibrated else _DESCRIBED, names, but=1),
        *[_row("baseline_scale", "baseline_length", "stereo pair", "length of the baseline",
               CameraEffect("length", (1.0,), 1))] * calibrated,
        *(_row(name, kind, "board", meaning, BoardEffect(shape)) for name, kind, meaning, shape in _SHAPES),
        _row("lean_roll", "lean", "base", "roll of the base against the floor's normal", BaseLean(0)),
        _row("lean_pitch", "lean", "base", "pitch of the base against the floor's normal", BaseLean(1)),
        _row("turn_slip", "turn_slip", "wheels", "effective separation at twice the mean turning rate",
             Widening("rate")),
        _row("turn_sides", "turn_sides", "wheels", "effective separation in left turns", Widening("side")),
        _row("wheel_delay", "wheel_delay", "wheels", "delay of the right wheel's readings against the left one's",
             WheelDelay()),
        _row("wheel_smoothing", "wheel_smoothing", "wheels", "filter of the readings (time constant squared)",
             WheelSmoothing()),
        *_of_cameras(_DELAYS, names, but=1),
        _row("readout", "readout", every, "time between the first and the last row",
             CameraEffect("readout_s", (1.0,), None)),
    )
    # fmt: on


#: The constants of a stereo pair, the board and the clocks.
CONSTANTS = _common(SIDES, calibrated=True)


def _across(axis: FloatArray) -> Iterator[tuple[str, tuple[float, float, float]]]:
    """The two coordinate axes that are least aligned with a unit vector, (3,), made orthonormal to it."""
    least = sorted(np.argsort(np.abs(axis), kind="stable")[:2].tolist())
    first = np.eye(3)[least[0]] - axis[least[0]] * axis
    first /= np.linalg.norm(first)
    second = np.cross(axis, first)
    second *= np.sign(second[least[1]]) or 1.0
    for letter, e in zip(least, (first, second), strict=True):
        yield _LETTERS[letter], (float(e[0]), float(e[1]), float(e[2]))


def _of_baseline(cameras: CameraRig) -> Iterator[Constant]:
    if cameras.calibrated:
        t = cameras.T_c_each[1][:3, 3]
        for letter, e in _across(t / np.linalg.norm(t)):
            meaning = f"direction of the baseline about the {camera_words(cameras.names[0])}'s {letter}"
            swing = CameraEffect("swing", e, 1)
            yield _row(f"baseline_{letter}", "baseline_direction", "stereo pair", meaning, swing)


def joint_keys(chain: HeadChain) -> Mapping[int, str]:
    """Index of each moving link in the chain → the start of its constants' names: "pan", "tilt", or the joint."""
    roles = {name: role for role, name in (("pan", chain.pan), ("tilt", chain.tilt)) if name}
    keys: dict[int, str] = {}
    for index, link in enumerate(chain.links):
        if isinstance(link, JointLink):
            key = roles.get(link.joint, link.joint)
            count = sum(other == key or other.startswith(f"{key}_") for other in keys.values())
            keys[index] = f"{key}_{count + 1}" if count else key
    return keys


def joint_constants(chain: HeadChain) -> Iterator[Constant]:
    """Rows of the head's joints: zeros, scales, backlash, axes and positions."""
    keys = joint_keys(chain)
    columns = {name: k for k, name in enumerate(chain.joints)}
    done: set[str] = set()
    for index, key in keys.items():
        link = chain.links[index]
        assert isinstance(link, JointLink)
        part, column = link.joint, columns[link.joint]
        if link.joint not in done:
            done.add(link.joint)
            unit = chain.joint_units[column]
            if index != max(keys):  # the head-eye transform absorbs the last zero exactly
                yield _row(
                    f"{key}_zero", "joint_zero", part, "zero position", JointReading(column, "zero"), unit
                )
            yield _row(
                f"{key}_scale", "joint_scale", part, "scale of the reading", JointReading(column, "scale")
            )
            yield _row(f"backlash_{key}", "backlash", part, "backlash", JointReading(column, "play"), unit)
        for letter, e in _across(link.axis):
            meaning = f"direction of the axis, about {letter}"
            yield _row(f"{key}_axis_{letter}", "joint_axis", part, meaning, ChainEffect(index, "turn", e))
            if link.kind == "revolute":
                meaning = f"position of the axis along {letter}"
                shift = ChainEffect(index, "shift", e)
                yield _row(f"{key}_position_{letter}", "joint_position", part, meaning, shift)


def table(cameras: CameraRig, chain: HeadChain) -> tuple[Constant, ...]:
    """The rows of all constants of a robot, with default priors."""
    usual = cameras.calibrated and cameras.names == SIDES
    common = CONSTANTS if usual else _common(cameras.names, cameras.calibrated)
    return (*common, *_of_baseline(cameras), *joint_constants(chain))


def clocks_of(logs: Iterable[int]) -> Iterator[Constant]:
    """Rows of the clocks of recordings, numbered from 0, against those of an earlier one."""
    for log in logs:
        for of, word in _CLOCKS:
            meaning = f"change of the {word} clock against the cameras' in recording {log + 1}"
            yield _row(f"time_{of}_{log + 1}", "clock", of, meaning, Clock(of, log))


def floors_of(logs: Iterable[int]) -> Iterator[Constant]:
    """Rows of the floor in recordings, numbered from 0: its shape, and how it carries the base."""
    for log in logs:
        number = f"_{log + 1}" if log else ""
        for a, b in _FLOOR_POWERS:
            term = "x" * a + "y" * b
            meaning = f"height of the {term} term at 1 m"
            effect = FloorShape((a, b), log, len(_FLOOR_POWERS))
            yield _row(f"floor_{term}{number}", "floor_shape", "floor", meaning, effect)
        for axis, letter in enumerate("xy"):
            meaning = f"drift along {letter} per meter of wheel travel"
            yield _row(f"drift_{letter}{number}", "floor_drift", "floor", meaning, FloorDrift(axis, log))


def clock_s(of: str, log: int, constants: Mapping[str, float]) -> float:
    """Offset of the clock of "joints" or "wheels" in a recording, s, of estimated constants by name."""
    return constants.get(f"time_{of}", 0.0) + constants.get(f"time_{of}_{log + 1}", 0.0)


def camera_change(
    cameras: CameraRig, constants: Iterable[Constant], values: Mapping[str, float]
) -> CameraChange:
    """What estimated constants change in the cameras.

    Args:
        cameras: as stated.
        constants: rows; those that do not change the cameras are ignored.
        values: name of a constant → its value; those that are not there are zero.
    """
    effects = [(row.name, row.effect) for row in constants if isinstance(row.effect, CameraEffect)]
    lens_terms = max((len(effect.along) for _, effect in effects if effect.of == "lens"), default=4)
    change = CameraChange.none(len(cameras.each), lens_terms)
    for name, effect in effects:
        if values.get(name):
            effect.add(change, values[name])
    return change


def corrected_chain(chain: HeadChain, values: Mapping[str, float]) -> tuple[HeadChain, FloatArray]:
    """What estimated constants change in a head chain, beside scale and backlash of the joints.

    Args:
        chain: as stated.
        values: name of a constant → its value; those that are not there are zero.

    Returns:
        The chain with the estimated axes and positions of the joints, and (J,) their zeros, rad or m, to be added to
        the readings.
    """
    change, zeros = ChainChange(), np.zeros(len(chain.joints))
    for row in joint_constants(chain):
        value, effect = values.get(row.name, 0.0), row.effect
        if value and isinstance(effect, ChainEffect):
            effect.add(change, value)
        elif isinstance(effect, JointReading) and effect.error == "zero":
            zeros[effect.joint] = value
    return change.apply(chain), zeros


def with_priors(rows: Iterable[Constant], sigmas: Mapping[str, float]) -> Iterator[Constant]:
    """Rows with the priors that a user gives, without those that are exact.

    Args:
        rows: with default priors.
        sigmas: name, kind or "all" → prior sigma in the kind's unit: 0 for exact, infinite for free.
    """
    for row in rows:
        sigma = sigmas.get(row.name, sigmas.get(row.kind, sigmas.get("all", row.sigma)))
        if sigma > 0:
            wide = FREED_SIGMAS * row.sigma if math.isinf(sigma) else sigma
            yield replace(row, sigma=wide)


_E = TypeVar("_E", bound=Effect)


@dataclass(frozen=True)
class Layout:
    """Columns of the parameters that all recordings share: the nine and the estimated constants.

    Attributes:
        constants: rows of the estimated constants, in the order of the table.
    """

    constants: tuple[Constant, ...] = ()

    @cached_property
    def names(self) -> tuple[str, ...]:
        """Names of the columns."""
        return (*NINE, *(row.name for row in self.constants))

    @property
    def size(self) -> int:
        """Number of columns."""
        return len(NINE) + len(self.constants)

    def of(self, kind: type[_E]) -> tuple[tuple[int, str, _E], ...]:
        """(column, name, effect) of the constants with one kind of effect."""
        if kind not in self._of:
            rows = enumerate(self.constants, len(NINE))
            self._of[kind] = tuple(
                (k, row.name, row.effect) for k, row in rows if isinstance(row.effect, kind)
            )
        return self._of[kind]

    @cached_property
    def _of(self) -> dict[type[Effect], tuple[tuple[int, str, Any], ...]]:
        return {}

    @property
    def direct(self) -> tuple[tuple[int, str, ImageEffect], ...]:
        """Those of the constants that change the cameras or the board, not the camera's pose."""
        return self.of(ImageEffect)

    def prior_sigmas(self, wheels: WheelGeometry) -> FloatArray:
        """(P,) prior sigmas of the nine around nominal values, and of the constants around zero."""
        constants = [row.sigma for row in self.constants]
        return np.concatenate([NINE_SIGMAS, WHEEL_SIGMA * np.abs(wheels.vector), constants])
