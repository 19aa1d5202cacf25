"""Differential drive: motion of the base from wheel rotations (paper, eqs. 1, 10, 11, 14)."""

from __future__ import annotations

from dataclasses import dataclass, field
from functools import cached_property, lru_cache
from typing import Literal

import numpy as np

from mobilecal_cli.model.arrays import BoolArray, FloatArray, IntArray
from mobilecal_cli.model.observations import WheelTrack
from mobilecal_cli.model.rig import WheelGeometry
from mobilecal_cli.model.signals import Track

_ROUNDING_RAD = 1e-9  # of readings that are printed with nine digits
_WHOLE_STEPS = 0.01  # a sound change is so near to a whole number of steps
_ROUNDING_STEPS = 1e-6  # agreement in steps that says no more
_FEW_READINGS = 10  # of one wheel in one recording
_CORRUPTED = 0.02  # share of the changes that may be anything
_MOST_PARTS = 30  # steps in the smallest change
_CHANGES_TRIED = 500  # enough to find no divisor of smooth readings, and fast
_CHANGES_FIRST = 25  # of these: enough to exclude most candidates
_BY_CHANCE = 1e-3  # probability
_FEW_STEPS = 2.5  # between two readings: their middle is nearer to the truth than they are
# Rates are means over the first to either side; accelerations over the second, as steps of encoders count twice there.
_RATE_NS, _ACCELERATION_NS = 50_000_000, 100_000_000
_LEAST_HALF_S = 1e-3  # at the ends of a track, where there is no acceleration but rounding
_SLOW = 0.2  # of the mean turning rate
_SMALL = 0.1  # rad; below this the series' error (h^10 / 11!) is less than one ulp


Unevenness = Literal["rate", "side"]


@dataclass(frozen=True, slots=True, eq=False)
class Increments:
    """Wheel rotations between stations, split into steps with constant wheel rates.

    Attributes:
        right_rad, left_rad: (n,) rotation in each step.
        leg: (n,) leg of each step, not decreasing.
        legs: number of legs; a leg without motion has no steps.
        motion: (n, 2, 2, 2) at the start and the end of each step, rates and accelerations of the right and left wheel,
            rad/s and rad/s^2; NaN where they are unknown, by default everywhere.
    """

    right_rad: FloatArray
    left_rad: FloatArray
    leg: IntArray
    legs: int
    motion: FloatArray = field(default_factory=lambda: np.zeros(0))

    def __post_init__(self) -> None:
        if not len(self.motion):
            object.__setattr__(self, "motion", np.full((len(self.leg), 2, 2, 2), np.nan))

    @property
    def changes(self) -> FloatArray:
        """(2, n, 2) growth of the rates and accelerations of the right and left wheel in each step; 0 if unknown."""
        return np.asarray(np.moveaxis(np.nan_to_num(self.motion[:, 1] - self.motion[:, 0]), 1, 0))

    def unevenness(self, of: Unevenness) -> FloatArray:
        """(n,) how a step differs from the mean turn (all weighted with the turns); 0 where its rate is unknown.

        Args:
            of: "rate", the turning rate over its mean, less 1, at most 1; "side", 1 to the left and -1 to the right,
                less in slow turns, whose side is noise, minus its mean.
        """
        rate = np.mean(self.motion[:, :, 0] @ [1.0, -1.0], axis=1)
        known = np.isfinite(rate)
        turned = np.abs(self.right_rad - self.left_rad) * known
        rate = np.where(known, rate, 0.0)
        all_turned = max(float(turned.sum()), 1e-12)
        mean = max(float(turned @ np.abs(rate)) / all_turned, 1e-12)
        if of == "rate":
            return np.where(known, np.minimum(np.abs(rate) / mean - 1, 1.0), 0.0)
        side = rate / np.hypot(rate, _SLOW * mean)
        return np.where(known, side - float(turned @ side) / all_turned, 0.0)

    def total(self, per_step: FloatArray) -> FloatArray:
        """Sum over the steps of each leg: (n,) → (legs,)."""
        return np.bincount(self.leg, weights=per_step, minlength=self.legs).astype(np.float64)

    @property
    def totals_rad(self) -> FloatArray:
        """(legs, 2) rotation of the right and left wheel over each leg: the matrix Phi of eq. 12."""
        return np.stack([self.total(self.right_rad), self.total(self.left_rad)], axis=1)

    def select(self, legs: IntArray) -> Increments:
        """Steps of some legs (increasing indices), renumbered."""
        number = np.full(self.legs, -1)
        number[legs] = np.arange(len(legs))
        kept = number[self.leg] >= 0
        steps = (self.right_rad[kept], self.left_rad[kept], number[self.leg[kept]])
        return Increments(*steps, len(legs), self.motion[kept])

    def with_ends(self, start_rad: FloatArray, end_rad: FloatArray) -> Increments:
        """Increments with one more step at the start and end of every leg: (legs, 2) each, right and left, rad."""
        legs = np.arange(self.legs)
        leg = np.concatenate([legs, self.leg, legs])
        order = np.argsort(leg, kind="stable")
        right = np.concatenate([start_rad[:, 0], self.right_rad, end_rad[:, 0]])
        left = np.concatenate([start_rad[:, 1], self.left_rad, end_rad[:, 1]])
        unknown = np.full((self.legs, *self.motion.shape[1:]), np.nan)
        motion = np.concatenate([unknown, self.motion, unknown])
        return Increments(right[order], left[order], leg[order], self.legs, motion[order])


def encoder_step_rad(readings_rad: FloatArray) -> float:
    """Resolution of an encoder: the greatest common divisor of its changes, (n,) → rad; 0 if there is none.

    A few changes may be corrupted. The divisor is a whole part of the smallest sound change.
    """
    changes = np.abs(np.diff(readings_rad))
    changes = changes[changes > _ROUNDING_RAD]
    if not len(changes):
        return 0.0
    # A part of the changes decides whether there is a divisor at all: most smooth readings end here.
    some = np.sort(changes[:: -(-len(changes) // _CHANGES_TRIED)])
    smallest = some[: int(_CORRUPTED * len(some)) + 1]
    smallest = smallest[np.append(True, np.diff(smallest) > _WHOLE_STEPS * smallest[:-1])]
    candidates = np.unique(np.append(smallest[:, None] / np.arange(1, _MOST_PARTS + 1), changes.min()))
    _, _, sound = _whole_steps(candidates[:, None], some[:: -(-len(some) // _CHANGES_FIRST)])
    possible = np.count_nonzero(~sound, axis=1) <= _CORRUPTED * len(some)
    for step in candidates[possible][::-1]:
        if _divides(step, some, len(candidates)) and _divides(step, changes, len(candidates)):
            multiples, _, sound = _whole_steps(step, changes)
            return float(np.median(changes[sound] / multiples[sound]))  # readings may be rounded
    return 0.0


def _whole_steps(step: float | FloatArray, changes: FloatArray) -> tuple[FloatArray, FloatArray, BoolArray]:
    """Changes as numbers of steps, their distance from whole ones, and whether each is a whole one, not 0."""
    steps = changes / step
    multiples = np.rint(steps)
    off = np.abs(steps - multiples)
    return multiples, off, (off < _WHOLE_STEPS) & (multiples > 0)


def _divides(step: float, changes: FloatArray, tried: int) -> bool:
    """Whether the changes are multiples of a step, and not by chance, given the number of steps that were tried."""
    multiples, off, sound = _whole_steps(step, changes)
    if sound.sum() < (1 - _CORRUPTED) * len(changes):
        return False
    different = len(np.unique(multiples[sound]))
    if sound.all() and multiples.min() == 1:  # whole multiples of a change that was read
        return True
    by_chance = 2 * max(float(off[sound].max()), _ROUNDING_STEPS)
    return bool(tried * by_chance ** (different - 1) < _BY_CHANCE)


@lru_cache(maxsize=8)  # the search for a mistake asks for the same tracks with each of its hypotheses
def encoder_steps_rad(tracks: tuple[WheelTrack, ...]) -> FloatArray:
    """Resolution of the right and left wheel's encoder, the largest over the recordings, (2,).

    Recordings with few readings say nothing alone: they count as one.
    """
    steps_rad = []
    for readings in ([track.right.value for track in tracks], [track.left.value for track in tracks]):
        short = [np.diff(values) for values in readings if len(values) < _FEW_READINGS]
        joined = [np.cumsum(np.concatenate([[0.0], *short]))] if short else []
        long = [values for values in readings if len(values) >= _FEW_READINGS]
        steps_rad.append(max((encoder_step_rad(values) for values in long + joined), default=0.0))
    found = np.array(steps_rad)
    found.setflags(write=False)
    return found


def between_steps(track: Track, step_rad: float) -> Track:
    """A wheel without encoder quantization: linear between the changes of its reading by a step or two.

    Such a reading is most accurate at the moment it changes. At any other time it can be wrong by half a step, with the
    same sign until the next change. Where a reading differs from the one before by more steps, both stay as they are:
    a line between the middles of such changes would round off every change of speed. So it would where the wheel turns
    back: readings between two opposite changes stay, too. A wheel without steps stays.
    """
    if not step_rad:
        return track
    offsets, value = (track.time_ns - track.time_ns[0]).astype(np.float64), track.value
    change = np.diff(value)
    size, changed = np.abs(change), np.flatnonzero(change)
    slow = (size > 0) & (size < _FEW_STEPS * step_rad)
    fast = np.flatnonzero(size >= _FEW_STEPS * step_rad)
    back = np.flatnonzero(np.diff(np.sign(change[changed])))
    ends = (0, len(value) - 1)
    kept = np.unique(np.concatenate([ends, fast, fast + 1, changed[back] + 1, changed[back + 1]]))
    at = np.concatenate([offsets[kept], (offsets[1:] + offsets[:-1])[slow] / 2])
    values = np.concatenate([value[kept], (value[1:] + value[:-1])[slow] / 2])
    order = np.argsort(at, kind="stable")
    return Track(track.time_ns, np.interp(offsets, at[order], values[order]))


def cut_at(track: WheelTrack, times_ns: IntArray, motion: bool = False) -> Increments:
    """Increments of a wheel track, split at the stations' times and at the readings of either wheel.

    Args:
        track: both wheels of one recording.
        times_ns: (N,) increasing, inside the time that both wheels cover.
        motion: with the wheels' rates and accelerations, which take longer than all else.

    Returns:
        Steps of the N - 1 legs between consecutive stations. Steps at rest are omitted.
    """
    place = np.searchsorted(track.time_ns, times_ns)
    between = track.time_ns[np.minimum(place, len(track.time_ns) - 1)] != times_ns
    moments = np.insert(track.time_ns, place[between], times_ns[between])
    moments = moments[(moments >= times_ns[0]) & (moments <= times_ns[-1])]
    right, left = np.diff(track.right.at(moments)), np.diff(track.left.at(moments))
    leg = np.searchsorted(times_ns, moments[:-1], side="right") - 1
    moved = (right != 0) | (left != 0)
    of_steps = np.zeros(0)
    if motion:
        at_moments = _motion(track, moments)
        of_steps = np.stack([at_moments[:-1], at_moments[1:]], axis=1)
        moved |= np.any(of_steps != 0, axis=(1, 2, 3))
        of_steps = of_steps[moved]
    return Increments(right[moved], left[moved], leg[moved], len(times_ns) - 1, of_steps)


def _motion(track: WheelTrack, moments_ns: IntArray) -> FloatArray:
    """(n, 2, 2) rates and accelerations of the right and left wheel around some moments, rad/s and rad/s^2."""
    start_ns, end_ns = track.time_ns[[0, -1]]
    before, after = (np.clip(moments_ns + way * _RATE_NS, start_ns, end_ns) for way in (-1, 1))
    span_s = np.maximum((after - before) * 1e-9, 1e-9)
    half_ns = np.minimum(_ACCELERATION_NS, np.minimum(moments_ns - start_ns, end_ns - moments_ns))
    half_s = np.maximum(half_ns * 1e-9, _LEAST_HALF_S)
    wheels = (track.right, track.left)
    rates = [(wheel.at(after) - wheel.at(before)) / span_s for wheel in wheels]
    accelerations = [
        (wheel.at(moments_ns + half_ns) - 2 * wheel.at(moments_ns) + wheel.at(moments_ns - half_ns))
        / half_s**2
        for wheel in wheels
    ]
    return np.stack([np.stack(each, axis=1) for each in (rates, accelerations)], axis=1)


def join(parts: list[Increments]) -> Increments:
    """Legs of several recordings, one recording after the other."""
    offsets = np.cumsum([0, *(part.legs for part in parts)])
    return Increments(
        np.concatenate([part.right_rad for part in parts]),
        np.concatenate([part.left_rad for part in parts]),
        np.concatenate([part.leg + offset for part, offset in zip(parts, offsets[:-1], strict=True)]),
        int(offsets[-1]),
        np.concatenate([part.motion for part in parts]),
    )


def _up_to(steps: Increments, amount: FloatArray) -> FloatArray:
    """Sum of a quantity within the leg up to and including each step, (n,) → (n,)."""
    total = np.cumsum(amount)
    first = np.searchsorted(steps.leg, np.arange(steps.legs))
    earlier = np.concatenate([[0.0], total])[first]
    return np.asarray(total - earlier[steps.leg])


def _arc(half_turn: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Chord of a unit arc that turns by 2h, sin(h)/h, and its derivative."""
    h, q = half_turn, half_turn**2
    chord = 1 - q / 6 * (1 - q / 20 * (1 - q / 42 * (1 - q / 72)))
    slope = -h / 3 * (1 - q / 10 * (1 - q / 28 * (1 - q / 54 * (1 - q / 88))))
    large = np.flatnonzero(np.abs(h) > _SMALL)  # rare, because samples are frequent
    chord[large] = np.sin(h[large]) / h[large]
    slope[large] = (np.cos(h[large]) - chord[large]) / h[large]
    return chord, slope


@dataclass(frozen=True, eq=False)
class Arcs:
    """Steps of all legs as circular arcs, and the resulting motion T_vi_vj = (Rz(psi), t) (eqs. 10 and 14).

    A step turns by ``psi = (rR phiR - rL phiL) / b`` and moves the base by the chord ``ds sin(h)/h``,
    ``ds = (rR phiR + rL phiL) / 2``, in the direction ``theta + h``, with ``h = psi/2``: exact for constant rates
    within a step.

    Attributes:
        steps, wheels: rotations and sizes of the wheels.
        ds, turn: (n,) length and turn of each step, m and rad.
        direction: (2, n) of each chord, in the frame of its leg's start.
        chord, slope: (n,) chord length / arc length, and its derivative by h.
    """

    steps: Increments
    wheels: WheelGeometry
    ds: FloatArray
    turn: FloatArray
    direction: FloatArray
    chord: FloatArray
    slope: FloatArray

    @cached_property
    def psi_rad(self) -> FloatArray:
        """(L,) heading change over each leg, not wrapped."""
        return self.steps.total(self.turn)

    @cached_property
    def t_m(self) -> FloatArray:
        """(L, 2) x and y of the new base origin in the old base frame."""
        x, y = self.ds * self.chord * self.direction
        return np.stack([self.steps.total(x), self.steps.total(y)], axis=1)

    @cached_property
    def _by_step(self) -> tuple[FloatArray, FloatArray]:
        """(2, n) derivatives of the end (x, y) of each step's leg by the step's length and by its turn.

        The length acts along the chord. The turn bends the step itself and rotates all later steps.
        """
        by_length = self.chord * self.direction
        cos, sin = self.direction
        steps = self.steps
        x, y = (steps.total(way)[steps.leg] - _up_to(steps, way) for way in self.ds * by_length)
        bent, swung = self.ds * self.slope / 2, self.ds * self.chord / 2
        return by_length, np.stack([bent * cos - swung * sin - y, bent * sin + swung * cos + x])

    def by_wheels(self) -> FloatArray:
        """(L, 3, 3) derivatives of (x, y, psi) by (rR, rL, b), m/m and rad/m."""
        steps, b = self.steps, self.wheels.separation_m
        right, left = steps.right_rad, steps.left_rad
        out = np.empty((steps.legs, 3, 3))
        for k, (by_length, by_turn) in enumerate(zip(*self._by_step, strict=True)):
            out[:, k, 0] = steps.total(right * (by_length / 2 + by_turn / b))
            out[:, k, 1] = steps.total(left * (by_length / 2 - by_turn / b))
            out[:, k, 2] = -steps.total(self.turn * by_turn) / b
        out[:, 2] = np.stack([steps.total(right), -steps.total(left), -self.psi_rad], axis=1) / b
        return out

    def by_rotations(self, right: FloatArray, left: FloatArray) -> FloatArray:
        """(L, 3) derivatives of (x, y, psi) by a number that changes each step's rotations at these rates, (n,)."""
        change = self.sensitivity() @ np.stack([right, left], axis=1)[:, :, None]
        return np.stack([self.steps.total(part) for part in change[..., 0].T], axis=1)

    def sensitivity(self, at: IntArray | slice = slice(None)) -> FloatArray:
        """Derivatives of the leg ends by the wheel rotations of some steps.

        Returns:
            (k, 3, 2) derivatives of the leg's (x, y, psi) by the right and left rotation of one of its steps,
            m/rad and rad/rad.
        """
        rR, rL, b = self.wheels.vector
        by_length, by_turn = (by[:, at] for by in self._by_step)
        out = np.empty((3, 2, by_turn.shape[1]))
        out[:2, 0] = rR * (by_length / 2 + by_turn / b)
        out[:2, 1] = rL * (by_length / 2 - by_turn / b)
        out[2] = [[rR / b], [-rL / b]]
        return np.moveaxis(out, -1, 0)


def integrate(steps: Increments, wheels: WheelGeometry) -> Arcs:
    """Motion over each leg by dead reckoning along circular arcs, with its derivatives; see `Arcs`."""
    right, left = wheels.radius_right_m * steps.right_rad, wheels.radius_left_m * steps.left_rad
    turn = (right - left) / wheels.separation_m
    heading = _up_to(steps, turn) - turn / 2
    direction = np.stack([np.cos(heading), np.sin(heading)])
    return Arcs(steps, wheels, (right + left) / 2, turn, direction, *_arc(turn / 2))
