"""What a log says over time, before anything is seen in its pictures. Time is integer nanoseconds."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np

from mobilecal_cli.model.arrays import FloatArray, IntArray, freeze
from mobilecal_cli.model.rig import Side


@dataclass(frozen=True, slots=True, eq=False)
class Track:
    """One quantity over time.

    Attributes:
        time_ns: (n,) strictly increasing.
        value: (n,) rad (a revolute joint, a wheel's unwrapped rotation) or m (a prismatic joint).
    """

    time_ns: IntArray
    value: FloatArray

    def __post_init__(self) -> None:
        n = freeze(self, np.int64, time_ns=("n",))["n"]
        freeze(self, value=(n,))

    def at(self, times_ns: IntArray) -> FloatArray:
        """Values at some times, by linear interpolation; (n,) → (n,).

        Takes no longer on a long track: only the readings about those times are looked at.
        """
        if not len(times_ns):
            return np.zeros(0)
        begin = max(int(np.searchsorted(self.time_ns, times_ns.min())) - 1, 0)
        end = int(np.searchsorted(self.time_ns, times_ns.max())) + 1
        stamps, start = self.time_ns[begin:end], self.time_ns[begin]
        # Offsets from the start are small enough for float64 to hold every nanosecond.
        offsets, samples = (times_ns - start).astype(np.float64), (stamps - start).astype(np.float64)
        return np.asarray(np.interp(offsets, samples, self.value[begin:end]), dtype=np.float64)


@dataclass(frozen=True, slots=True, eq=False)
class Signals:
    """A recording without its pictures' contents.

    Attributes:
        joints: head joint name → track.
        wheels: side → unwrapped wheel rotation, rad, positive when driving forward.
        image_ns: side → (n,) stamps of the pictures, strictly increasing.
        notes: what was odd: clocks that stepped back, duplicate stamps, gaps, zero stamps. Whole sentences.
    """

    joints: Mapping[str, Track]
    wheels: Mapping[Side, Track]
    image_ns: Mapping[Side, IntArray]
    notes: tuple[str, ...]


@dataclass(frozen=True, slots=True)
class Shot:
    """A stereo pair that is to be looked at, named by the two pictures' stamps, ns."""

    left_ns: int
    right_ns: int

    @property
    def time_ns(self) -> int:
        """The moment of the pair: midway between the two stamps."""
        return (self.left_ns + self.right_ns) // 2


@dataclass(frozen=True, slots=True, eq=False)
class Station:
    """A moment at which the board may be seen.

    Attributes:
        index: number in its log, from 0, in order of time.
        at_rest: base and head stood still over all the shots.
        shots: the stereo pairs to look at: several at a rest, one otherwise.
        time_ns: mean time of the shots.
        joints: (J,) head joint readings at the shots, in the order of `HeadChain.joints`, rad or m.
        joints_std: (J,) scatter of the readings over the shots; 0 where there is one.
    """

    index: int
    at_rest: bool
    shots: tuple[Shot, ...]
    time_ns: int
    joints: FloatArray
    joints_std: FloatArray

    def __post_init__(self) -> None:
        freeze(self, joints=("J",), joints_std=("J",))


@dataclass(frozen=True, slots=True)
class Rejection:
    """One item that was left out, and why. Counted in the report; never an exception.

    Attributes:
        stage: "readers", "stations", "vision" or "solvers".
        reason: a few words, the same for all of a kind ("board partly hidden").
        detail: the numbers of this one.
        time_ns: when in the log.
        station: index of the station it belongs to, -1 where none.
        log: index of the recording.
    """

    stage: str
    reason: str
    detail: str
    time_ns: int
    station: int = -1
    log: int = 0
