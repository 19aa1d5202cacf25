"""The differential drive: from wheel rotations to the base's motion (paper, eqs. 1, 10, 11, 14)."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from mobilecal_cli.model import FloatArray, IntArray, WheelGeometry, WheelTrack

_ROUNDING_RAD = 1e-9
_WHOLE_STEPS = 0.01
_SMALL = 1e-4  # below it the series' error (x^4) is under one ulp


@dataclass(frozen=True, slots=True, eq=False)
class Increments:
    """Wheel rotations between stations, cut into steps in which both wheels turn at constant rates.

    Attributes:
        right_rad, left_rad: (n,) rotation in each step.
        leg: (n,) the leg that each step belongs to, not decreasing.
        legs: number of legs; a leg without motion has no steps.
    """

    right_rad: FloatArray
    left_rad: FloatArray
    leg: IntArray
    legs: int

    def total(self, per_step: FloatArray) -> FloatArray:
        """Sum over the steps of each leg: (n,) → (legs,)."""
        return np.bincount(self.leg, weights=per_step, minlength=self.legs).astype(np.float64)

    @property
    def totals_rad(self) -> FloatArray:
        """(legs, 2) rotation of the right and left wheel over each leg: the matrix Phi of eq. 12."""
        return np.stack([self.total(self.right_rad), self.total(self.left_rad)], axis=1)

    def select(self, legs: IntArray) -> Increments:
        """The steps of some legs (increasing indices), which are numbered anew."""
        number = np.full(self.legs, -1)
        number[legs] = np.arange(len(legs))
        kept = number[self.leg] >= 0
        return Increments(self.right_rad[kept], self.left_rad[kept], number[self.leg[kept]], len(legs))

    def with_ends(self, start_rad: FloatArray, end_rad: FloatArray) -> Increments:
        """One more step at the start and one at the end of every leg: (legs, 2) each, right and left, rad."""
        legs = np.arange(self.legs)
        leg = np.concatenate([legs, self.leg, legs])
        order = np.argsort(leg, kind="stable")
        right = np.concatenate([start_rad[:, 0], self.right_rad, end_rad[:, 0]])
        left = np.concatenate([start_rad[:, 1], self.left_rad, end_rad[:, 1]])
        return Increments(right[order], left[order], leg[order], self.legs)


def encoder_step_rad(readings_rad: FloatArray) -> float:
    """Resolution of an encoder: the change of which all changes are multiples, (n,) → rad; 0 where there is none."""
    changes = np.abs(np.diff(readings_rad))
    changes = changes[changes > _ROUNDING_RAD]
    if not len(changes):
        return 0.0
    steps = changes / changes.min()
    return float(changes.min()) if np.abs(steps - np.round(steps)).max() < _WHOLE_STEPS else 0.0


def between_steps(track: WheelTrack) -> WheelTrack:
    """A track without the stairs that an encoder makes: straight lines from one change of a reading to the next.

    A reading changes where the wheel passes from one step to the next, and so tells best then. At every other moment
    it may be wrong by half a step, always the same way for as long as it does not change.
    """

    def smooth(readings_rad: FloatArray) -> FloatArray:
        changes = np.flatnonzero(np.diff(readings_rad))
        middle_ns = (offsets[changes] + offsets[changes + 1]) / 2
        middle_rad = (readings_rad[changes] + readings_rad[changes + 1]) / 2
        at = np.concatenate([offsets[:1], middle_ns, offsets[-1:]])
        values = np.concatenate([readings_rad[:1], middle_rad, readings_rad[-1:]])
        return np.asarray(np.interp(offsets, at, values), dtype=np.float64)

    offsets = (track.time_ns - track.time_ns[0]).astype(np.float64)
    return WheelTrack(track.time_ns, smooth(track.right_rad), smooth(track.left_rad))


def cut_at(track: WheelTrack, times_ns: IntArray) -> Increments:
    """Cut a wheel track at the stations' times.

    Args:
        track: both wheels of one log.
        times_ns: (N,) increasing, inside the track's span.

    Returns:
        Steps of the N - 1 legs between consecutive stations. Steps without any rotation are left out.
    """
    start = track.time_ns[0]
    place = np.searchsorted(track.time_ns, times_ns)
    between = track.time_ns[np.minimum(place, len(track.time_ns) - 1)] != times_ns
    moments = np.insert(track.time_ns, place[between], times_ns[between])
    moments = moments[(moments >= times_ns[0]) & (moments <= times_ns[-1])]
    # Offsets from the start are small enough for float64 to hold every nanosecond.
    at, samples = (moments - start).astype(np.float64), (track.time_ns - start).astype(np.float64)
    right = np.diff(np.interp(at, samples, track.right_rad))
    left = np.diff(np.interp(at, samples, track.left_rad))
    leg = np.searchsorted(times_ns, moments[:-1], side="right") - 1
    moved = (right != 0) | (left != 0)
    return Increments(right[moved], left[moved], leg[moved], len(times_ns) - 1)


def join(parts: list[Increments]) -> Increments:
    """The legs of several logs, one log's after the other's."""
    offsets = np.cumsum([0, *(part.legs for part in parts)])
    return Increments(
        np.concatenate([part.right_rad for part in parts]),
        np.concatenate([part.left_rad for part in parts]),
        np.concatenate([part.leg + offset for part, offset in zip(parts, offsets[:-1], strict=True)]),
        int(offsets[-1]),
    )


@dataclass(frozen=True, slots=True, eq=False)
class LegMotion:
    """The base's motion over each leg, T_vi_vj = (Rz(psi), t).

    Attributes:
        psi_rad: (L,) heading change, not wrapped.
        t_m: (L, 2) x and y of the new base origin in the old base frame.
    """

    psi_rad: FloatArray
    t_m: FloatArray


def _arc(half_turn: FloatArray) -> tuple[FloatArray, FloatArray]:
    """sin(h)/h, the chord of a unit arc that turns by 2h, and its derivative."""
    small = np.abs(half_turn) < _SMALL
    safe = np.where(small, 1.0, half_turn)
    chord = np.where(small, 1 - half_turn**2 / 6, np.sin(safe) / safe)
    slope = np.where(small, -half_turn / 3, (np.cos(safe) - chord) / safe)
    return chord, slope


def _before(steps: Increments, amount: FloatArray) -> FloatArray:
    """Sum of a quantity over the steps of the same leg before each step, (n,) → (n,)."""
    total = np.cumsum(amount)
    before = total - amount
    first = np.searchsorted(steps.leg, np.arange(steps.legs))
    start = np.append(before, total[-1] if len(total) else 0.0)[first]
    return np.asarray(before - start[steps.leg])


def _headings(steps: Increments, turn: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Heading before each step, relative to its leg's start, and each leg's sum, of turns (n,)."""
    return _before(steps, turn), steps.total(turn)


@dataclass(frozen=True, slots=True, eq=False)
class _Arcs:
    """Each step as an arc, (n,), and each leg's heading change, (L,)."""

    turn: FloatArray
    ds: FloatArray
    along: FloatArray
    chord: FloatArray
    slope: FloatArray
    psi: FloatArray

    def motion(self, steps: Increments) -> LegMotion:
        run = self.ds * self.chord
        x, y = steps.total(run * np.cos(self.along)), steps.total(run * np.sin(self.along))
        return LegMotion(self.psi, np.stack([x, y], axis=1))


def _arcs(steps: Increments, wheels: WheelGeometry) -> _Arcs:
    right, left = wheels.radius_right_m * steps.right_rad, wheels.radius_left_m * steps.left_rad
    turn = (right - left) / wheels.separation_m
    theta, psi = _headings(steps, turn)
    chord, slope = _arc(turn / 2)
    return _Arcs(turn, (right + left) / 2, theta + turn / 2, chord, slope, psi)


def integrate(steps: Increments, wheels: WheelGeometry) -> LegMotion:
    """Dead reckoning along circular arcs (eqs. 10 and 14; exact for constant rates within a step).

    ``psi = (rR dphiR - rL dphiL) / b`` and each step moves the base by the chord
    ``ds sin(h)/h`` in the direction ``theta + h``, with ``h = dpsi/2``.
    """
    return _arcs(steps, wheels).motion(steps)


def integrate_with_jacobian(
    steps: Increments, wheels: WheelGeometry
) -> tuple[LegMotion, FloatArray, FloatArray]:
    """`integrate`, with its derivatives by (rR, rL, b).

    Returns:
        The motion, d psi (L, 3) in rad/m and d t (L, 2, 3) in m/m.
    """
    arcs, b = _arcs(steps, wheels), wheels.separation_m
    direction = np.stack([np.cos(arcs.along), np.sin(arcs.along)])
    normal = np.stack([-direction[1], direction[0]])

    d_ds = (steps.right_rad / 2, steps.left_rad / 2, np.zeros_like(arcs.ds))
    d_turn = (steps.right_rad / b, -steps.left_rad / b, -arcs.turn / b)
    d_psi = np.empty((steps.legs, 3))
    d_t = np.empty((steps.legs, 2, 3))
    for k in range(3):
        d_theta, d_psi[:, k] = _headings(steps, d_turn[k])
        stretched = d_ds[k] * arcs.chord + arcs.ds * arcs.slope * d_turn[k] / 2
        swung = arcs.ds * arcs.chord * (d_theta + d_turn[k] / 2)
        d_step = stretched * direction + swung * normal
        d_t[:, :, k] = np.stack([steps.total(row) for row in d_step], axis=1)
    return arcs.motion(steps), d_psi, d_t


def step_sensitivity(steps: Increments, wheels: WheelGeometry) -> FloatArray:
    """How each step's wheel rotations move the end of its leg.

    Returns:
        (n, 3, 2) derivatives of the leg's (x, y, psi) by the right and left rotation of one of its steps,
        m/rad and rad/rad: the step's own chord, and the swing of all that follows it.
    """
    arcs = _arcs(steps, wheels)
    direction = np.stack([np.cos(arcs.along), np.sin(arcs.along)], axis=-1)
    normal = np.stack([-direction[:, 1], direction[:, 0]], axis=-1)
    walked = (arcs.ds * arcs.chord)[:, None] * direction
    end = np.stack([steps.total(walked[:, 0]), steps.total(walked[:, 1])], axis=-1)
    before = np.stack([_before(steps, walked[:, 0]), _before(steps, walked[:, 1])], axis=-1)
    rest = end[steps.leg] - before - walked
    swung = np.stack([-rest[:, 1], rest[:, 0]], axis=-1)
    out = np.empty((len(arcs.ds), 3, 2))
    sides = ((wheels.radius_right_m, 1.0), (wheels.radius_left_m, -1.0))
    for column, (radius, sign) in enumerate(sides):
        turn = sign * radius / wheels.separation_m
        stretched = radius / 2 * arcs.chord + arcs.ds * arcs.slope * turn / 2
        own = stretched[:, None] * direction + (arcs.ds * arcs.chord * turn / 2)[:, None] * normal
        out[:, :2, column] = own + turn * swung
        out[:, 2, column] = turn
    return out
