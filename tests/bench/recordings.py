"""Recordings for the performance tables: simulated, with a board that is occluded at times, and of any length."""

from collections.abc import Iterator
from dataclasses import replace
from pathlib import Path

import numpy as np

from mobilecal_cli.model.arrays import FloatArray
from mobilecal_cli.simulate.record import simulate
from mobilecal_cli.simulate.render import BoardRenderer
from mobilecal_cli.simulate.scenario import BLUR_PX, Scenario, World
from mobilecal_cli.targets import Pictures
from tests.bench.pictures import empty
from tests.records import Record, records_of, written

_STATIONS = 67  # three seconds each, ten stereo pairs a second: 2,000 pairs
#: Of a drive of just more than ten minutes, which is made in five.
TEN_MINUTES = 202
_STAMPED = ("sensor_msgs/msg/Image", "sensor_msgs/msg/CompressedImage", "sensor_msgs/msg/JointState")
_RATE_HZ = 10.0
_PERIOD_S, _HIDDEN_S, _PASSING_S = 12.0, 4.0, 0.5


class _PassingPerson(BoardRenderer):
    """For a third of the time a person occludes the board; entering and leaving take half a second each."""

    _pictures = 0

    def picture(self, T_x_k: FloatArray) -> FloatArray:
        number, self._pictures = self._pictures, self._pictures + 1
        phase = (number / _RATE_HZ) % _PERIOD_S
        image = super().picture(T_x_k)
        if phase < _HIDDEN_S:
            share = min(phase, _HIDDEN_S - phase, _PASSING_S) / _PASSING_S
            wide = int(share * image.shape[1])
            image = np.hstack([empty(number % 12)[:, :wide], image[:, wide:]])
        return image


class _Occluded(World):
    """A board that a person occludes at times."""

    def renderers(self, random: np.random.Generator) -> list[BoardRenderer]:
        return [_PassingPerson(camera, self.route.board, BLUR_PX, random) for camera in self.cameras.each]


def simulated(folder: Path, pictures: Pictures, occluded: bool, stations: int = _STATIONS) -> Path:
    """A recording without stops in a folder, made on first use."""
    path = folder / f"{'occluded' if occluded else 'open'}_{pictures}_{stations}.mcap"
    if not path.exists():
        scenario = Scenario(motion="moving", stations=stations, pictures=pictures, seed=3)
        simulate(scenario, path, world_of=_Occluded if occluded else World)
    return path


def _restamped(data: bytes, time_ns: int) -> bytes:
    """A message whose header comes first, with another stamp: seconds and nanoseconds follow the encapsulation."""
    sec, nanosec = divmod(time_ns, 10**9)
    return data[:4] + sec.to_bytes(4, "little") + nanosec.to_bytes(4, "little") + data[12:]


def stretched(source: Path, out: Path, minutes: float) -> Path:
    """The beginning of the recording, or the recording repeated forwards and backwards, of the given length.

    Backwards, all readings and images appear in opposite order. No robot drives so: where it turns, readings disagree.
    """
    once = [record for record in records_of(source) if record.topic != "/robot_description"]
    stamped = [record for record in once if record.type in _STAMPED]
    first, last = stamped[0].time_ns, stamped[-1].time_ns

    def repeated() -> Iterator[Record]:
        for record in records_of(source):
            if record.topic == "/robot_description" or record.type.endswith("CameraInfo"):
                yield record
        for leg in range(int(np.ceil(minutes * 60e9 / (last - first)))):
            begin = first + leg * (last - first)
            forwards = leg % 2 == 0
            for record in stamped if forwards else reversed(stamped):
                passed = record.time_ns - first if forwards else last - record.time_ns
                # The turning point belongs to both directions.
                if not ((leg and not passed) or passed > minutes * 60e9 - (begin - first)):
                    time_ns = begin + passed
                    data = _restamped(record.data, time_ns)
                    yield replace(record, time_ns=time_ns, publish_ns=time_ns, data=data)

    return written(out, repeated())
