"""Video, a frame a message: the paper's robot's sample pictures, encoded anew."""

import sys
from fractions import Fraction

import av
import numpy as np
import pytest
from foxglove_schemas_protobuf.CompressedVideo_pb2 import CompressedVideo
from google.protobuf.timestamp_pb2 import Timestamp
from mcap_protobuf.writer import Writer as ProtobufWriter

from mobilecal_cli.errors import RecordingError
from mobilecal_cli.model.rig import Sources
from mobilecal_cli.model.signals import Rejection
from mobilecal_cli.readers import open_recording, pictures_near
from mobilecal_cli.vision import Detection, detect

from . import recordings as r

TOPIC = "/stereo/left/image_raw/compressed"
ENCODERS = {"h264": "libx264", "h265": "libx265"}


@pytest.fixture(scope="module")
def pictures(sample_logs):
    """The first pictures of the left camera, gray."""
    with open_recording([sample_logs / "paper_robot.mcap"]) as recording:
        stamps = [m.decode().header.stamp for m in recording.messages([TOPIC])][:8]
        wanted = {"left": {stamp.sec * 10**9 + stamp.nanosec for stamp in stamps}}
        return [p for _, _, p in r.read_images(recording, {"left": TOPIC}, wanted)]


def encoded(pictures, kind: str) -> list[bytes]:
    """One packet a picture: a key frame, then frames that build on it."""
    context = av.CodecContext.create(ENCODERS[kind], "w")
    context.height, context.width = pictures[0].shape
    context.pix_fmt, context.framerate, context.time_base = "yuv420p", Fraction(10), Fraction(1, 10)
    quiet = {"x265-params": "log-level=none:bframes=0"} if kind == "h265" else {}
    context.options = {"tune": "zerolatency", "crf": "12", "preset": "ultrafast", "g": "100", **quiet}
    packets = []
    for picture in pictures:
        frame = av.VideoFrame.from_ndarray(np.ascontiguousarray(picture), format="gray")
        packets += context.encode(frame.reformat(format="yuv420p"))
    packets += context.encode(None)
    return [bytes(packet) for packet in packets]


def written(path, packets, kind):
    with path.open("wb") as stream, ProtobufWriter(stream) as writer:
        for k, data in enumerate(packets):
            stamp = r.START_NS + k * r.STEP_NS
            time = Timestamp(seconds=stamp // 10**9, nanos=stamp % 10**9)
            message = CompressedVideo(timestamp=time, data=data, format=kind)
            writer.write_message("/left/video", message, stamp)
    return path


def at(*numbers):
    return {"left": {r.START_NS + k * r.STEP_NS for k in numbers}}


@pytest.mark.parametrize("kind", ENCODERS)
def test_wanted_frames_come_out_whatever_they_build_on(pictures, tmp_path, kind):
    packets = encoded(pictures, kind)
    assert len(packets) == len(pictures)
    with open_recording([written(tmp_path / "log.mcap", packets, kind)]) as recording:
        found = {ns: p for _, ns, p in r.read_images(recording, {"left": "/left/video"}, at(2, 5, 7))}
    assert [(ns - r.START_NS) // r.STEP_NS for ns in sorted(found)] == [2, 5, 7]
    for ns, picture in found.items():
        original = pictures[(ns - r.START_NS) // r.STEP_NS]
        assert picture.shape == original.shape
        # Gray levels are carried in 16 to 235 and back: 1 of rounding beside the loss.
        assert np.abs(picture.astype(int) - original).mean() < 3
        seen, sharp = detect(picture, 9, 6), detect(original, 9, 6)
        assert isinstance(seen, Detection)
        assert isinstance(sharp, Detection)
        assert np.abs(seen.pixels - sharp.pixels).max() < 0.25


def test_frames_without_their_key_frame_and_damaged_ones_are_rejections(pictures, tmp_path):
    packets = encoded(pictures, "h264")
    broken = [*packets[1:4], packets[0], b"\x00\x00\x01garbage" * 9, *packets[1:3]]
    with open_recording([written(tmp_path / "log.mcap", broken, "h264")]) as recording:
        found = {ns: p for _, ns, p in r.read_images(recording, {"left": "/left/video"}, at(*range(7)))}
    kinds = [isinstance(found[ns], Rejection) for ns in sorted(found)]
    assert kinds[:5] == [True, True, True, False, True]
    assert "key frame" in found[r.START_NS].detail


def test_a_glance_sees_key_frames(pictures, tmp_path):
    first, second = encoded(pictures[:4], "h264"), encoded(pictures[4:], "h264")
    path = written(tmp_path / "log.mcap", [*first, *second], "h264")
    sources = Sources({"left": "/left/video"}, {}, {}, {})
    with open_recording([path]) as recording:
        seen = [
            picture
            for _, picture in pictures_near(recording, sources, [r.START_NS, r.START_NS + 2 * r.STEP_NS])
        ]
    assert len(seen) == 2
    for picture, original in zip(seen, (pictures[0], pictures[4]), strict=True):
        assert np.abs(picture.astype(int) - original).mean() < 3


def test_without_pyav_the_extra_is_named(pictures, tmp_path, monkeypatch):
    path = written(tmp_path / "log.mcap", encoded(pictures[:2], "h264"), "h264")
    monkeypatch.setitem(sys.modules, "av", None)
    with open_recording([path]) as recording:
        with pytest.raises(RecordingError, match="PyAV") as caught:
            list(r.read_images(recording, {"left": "/left/video"}, at(0)))
        assert ".[video]" in caught.value.hint
