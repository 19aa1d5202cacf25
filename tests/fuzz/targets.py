"""What is fuzzed: sound inputs, and what a user's command does with them."""

import base64
import io
import json
import shutil
import zipfile
from collections.abc import Callable
from contextlib import suppress
from dataclasses import dataclass, replace
from functools import partial
from pathlib import Path

import cv2
import numpy as np
from foxglove_schemas_protobuf.CameraCalibration_pb2 import CameraCalibration
from foxglove_schemas_protobuf.CompressedImage_pb2 import CompressedImage
from google.protobuf.timestamp_pb2 import Timestamp
from mcap.writer import CompressionType
from mcap_protobuf.writer import Writer as ProtobufWriter

from mobilecal_cli.calibrate import inspect
from mobilecal_cli.calibrate.batch import fleet_jobs
from mobilecal_cli.calibrate.gaps import require_stations
from mobilecal_cli.calibrate.load import load
from mobilecal_cli.errors import MobilecalError, RecordingError
from mobilecal_cli.export.extraction import extraction_from_npz, extraction_to_npz
from mobilecal_cli.export.formats.urdf import patched_urdf
from mobilecal_cli.export.params import parameters_from_yaml, params_yaml
from mobilecal_cli.kinematics.urdf import parse_urdf
from mobilecal_cli.model.calibration import CalibratedRobot
from mobilecal_cli.model.observations import Extraction, LogSource
from mobilecal_cli.model.rig import Sources, WheelGeometry, WheelSource
from mobilecal_cli.model.solution import Provenance
from mobilecal_cli.readers import open_recording, pictures_near, read_description, read_images, read_signals
from mobilecal_cli.report.comparison import Comparison, comparison_text
from mobilecal_cli.report.inspection import inspection_json, inspection_text
from mobilecal_cli.report.motion import motion_gaps
from mobilecal_cli.rig.config import load_rig
from mobilecal_cli.rig.resolve import survey_rig
from mobilecal_cli.rig.settings import settings_of
from mobilecal_cli.simulate.robot import PAPER_ROBOT, urdf_text
from mobilecal_cli.solvers import solve
from tests.extractions import Noise, simulated
from tests.formats import HEAD_EYE, text_of
from tests.readers import recordings as r
from tests.records import Record, written

Use = Callable[[Path], None]


@dataclass(frozen=True)
class Target:
    """One kind of input.

    Attributes:
        files: name in the input's directory → sound contents; the file of one name is the input itself.
        path: what the command is given, "" for the directory.
        use: what is done with it; raises MobilecalError, or nothing.
        zipped: the files are members of an archive, which is what the command is given: damage to them passes the
            archive's own checksums.
    """

    files: dict[str, bytes]
    path: str
    use: Use
    zipped: bool = False


def _read(path: Path, sources: Sources = r.SOURCES) -> None:
    """All that calibrate, inspect and init do with a recording before they look at pictures."""
    with open_recording([path]) as recording:
        recording.log_times()
        description = read_description(recording)
        survey_rig(load_rig(None, {}), description)
        for signals in read_signals(recording, sources):
            for _ in read_images(recording, sources, signals.images):
                pass
        for _ in pictures_near(recording, sources, [recording.start_ns or 0]):
            pass


def _glance(path: Path) -> None:
    found = inspect.inspect([path])
    inspection_json(found)
    inspection_text(found)


def _rig(path: Path) -> None:
    load_rig(path, {})


def _params(path: Path) -> None:
    robot = parameters_from_yaml(path.read_text(encoding="utf-8", errors="replace"), str(path))
    comparison_text(Comparison(("a", "b", "c"), (robot, robot, robot)))
    for made in HEAD_EYE:
        text_of(made, robot)
    text_of("ros2_control", robot, wheel_joints=robot.wheel_joints)


def _urdf(path: Path) -> None:
    urdf = parse_urdf(path.read_text(encoding="utf-8", errors="replace"))
    for tip in urdf.links[:50]:
        with suppress(MobilecalError):
            urdf.path(urdf.root, tip)
    wheels = ("wheel_left_joint", "wheel_right_joint")
    if urdf.joints.keys() >= set(wheels):
        with suppress(MobilecalError):
            for name in wheels:
                urdf.pose(urdf.root, urdf.joints[name].child)
    patched_urdf(path.read_bytes(), ROBOT, {"left": wheels[0], "right": wheels[1]})


def _manifest(path: Path) -> None:
    fleet_jobs(path, path.parent / "out", None, {}, ())


def _npz(path: Path) -> None:
    extraction = load([path], load_rig(None)).extraction
    require_stations(extraction)
    motion_gaps(extraction)


def _solved(path: Path) -> None:
    extraction = extraction_from_npz(path)
    require_stations(extraction)
    solve(extraction, "linear")


def _small_extraction() -> Extraction:
    extraction = simulated("standard", Noise(0.2, 0.003, 0.0, 1e-3), stations=6, seed=1)
    return replace(extraction, logs=(LogSource("log.mcap", "0" * 64),))


RIG = """\
board: {columns: 9, rows: 6, square_m: 0.08}
cameras:
  left: {image: /left/image_raw, info: /left/camera_info}
  right: {image: /right/image_raw, info: /right/camera_info}
  reference: left
  rectified: false
joints:
  topic: /joint_states
  pan: head_pan_joint
  tilt: head_tilt_joint
  fields: {head_pan_joint: {topic: /dynamixel, field: "motors[0].position", unit: deg}}
wheels:
  left: {topic: /ticks/left, field: data, ticks_per_revolution: 4096, bits: 16, sign: 1}
  right: {joint: wheel_right_joint}
head:
  base_frame: base_link
  head_frame: head_link
  chain:
    - {xyz_m: [0.1, 0, 1.2], rpy_rad: [0, 0, 0]}
    - {joint: head_pan_joint, axis: [0, 0, 1]}
    - {joint: head_tilt_joint, axis: [0, 1, 0]}
nominal:
  wheels: {radius_left_m: 0.08, radius_right_m: 0.08, separation_m: 0.4}
  head_eye: {translation_m: [0.05, 0.06, 0.02], quaternion_xyzw: [-0.5, 0.5, -0.5, 0.5]}
noise: {pixel_px: 0.2, wheel_rad_per_sqrt_rad: 0.003, joint_rad: 0.001}
gates: {reprojection_rms_px: 4, std.wheels.separation_m: 0.002}
"""
MANIFEST = b"robots: [{name: a, logs: [a.mcap, b.bag], config: rig.yaml}, {name: b, logs: [c.mcap]}]"
ROBOT = CalibratedRobot("head_link", "camera", np.eye(4), WheelGeometry(0.1, 0.1, 0.5))


_STAMP = {"sec": 5, "nsec": 7}
_INFO = {
    "timestamp": _STAMP, "frame_id": "left_optical", "width": 64, "height": 48, "distortion_model": "plumb_bob",
    "D": [0.1, 0, 0, 0, 0], "K": [50, 0, 32, 0, 50, 24, 0, 0, 1], "R": [1, 0, 0, 0, 1, 0, 0, 0, 1],
    "P": [50, 0, 32, 0, 0, 50, 24, 0, 0, 0, 1, 0],
}  # fmt: skip


def _in_json(path: Path) -> None:
    """Messages of JSON, without checksums so that damage reaches them."""
    picture = base64.b64encode(cv2.imencode(".png", r.picture(1))[1].tobytes()).decode()
    header = {"stamp": {"sec": 5, "nanosec": 7}, "frame_id": ""}
    left = {"timestamp": _STAMP, "frame_id": "left", "format": "png", "data": picture}
    right = {
        "timestamp": _STAMP,
        "frame_id": "right",
        "width": 2,
        "height": 2,
        "step": 2,
        "encoding": "mono8",
    }
    joints = {"header": header, "name": ["pan", "tilt"], "position": [0.1, 0.2]}
    kinds = {
        "/left/camera_info": ("foxglove.CameraCalibration", _INFO),
        "/left/image_raw": ("foxglove.CompressedImage", left),
        "/right/image/compressed": ("foxglove.RawImage", right | {"data": "AAEC"}),
        "/joint_states": ("sensor_msgs/JointState", joints),
        "/ticks": ("encoders", {"header": header, "counts": [5, 6]}),
    }
    messages = (
        Record(topic, kind, b"{}", 5 * 10**9 + k, json.dumps(fields).encode(), **r.JSON)
        for topic, (kind, fields) in kinds.items()
        for k in range(4)
    )
    written(path, messages, profile="", enable_crcs=False)


def _in_protobuf(path: Path) -> None:
    """The same in Foxglove's protobuf messages; joints and ticks are left out."""
    stamp = Timestamp(seconds=5, nanos=7)
    data = cv2.imencode(".png", r.picture(1))[1].tobytes()
    info = {key: value for key, value in _INFO.items() if key != "timestamp"}
    with path.open("wb") as stream, ProtobufWriter(stream, enable_crcs=False) as writer:
        for k in range(4):
            calibration = CameraCalibration(timestamp=stamp, **info)
            writer.write_message("/left/camera_info", calibration, 5 * 10**9 + k)
            picture = CompressedImage(timestamp=stamp, frame_id="left", data=data, format="png")
            writer.write_message("/left/image_raw", picture, 5 * 10**9 + k)


_ELSEWHERE = Sources(
    image={"left": "/left/image_raw", "right": "/right/image/compressed"},
    info={},
    joints={"pan": "/joint_states", "tilt": "/joint_states"},
    wheels={
        "left": WheelSource("/ticks", field="counts[0]", ticks_per_revolution=100, bits=16),
        "right": WheelSource("/ticks", field="counts[1]", ticks_per_revolution=100, bits=16),
    },
)


def _pictures_only(path: Path) -> None:
    """Pictures and calibrations without anything that moves: all messages are decoded."""
    with open_recording([path]) as recording:
        recording.log_times()
        read_description(recording)
        images = dict.fromkeys(("left", "right"), "/left/image_raw")
        sources = Sources(image=images, info={}, joints={}, wheels={})
        for _, picture in pictures_near(recording, sources, [recording.start_ns or 0]):
            assert picture is not None
        for message in recording.messages([info.name for info in recording.topics]):
            with suppress(RecordingError):
                message.decode()


def targets(folder: Path) -> dict[str, Target]:
    """All of them; sound containers are written below a folder."""
    items = r.world(12)
    found = {}
    for name, write in r.CONTAINERS.items():
        (folder / name).mkdir(parents=True)
        path = write(folder / name / "log", items)
        inside = path if path.is_dir() else path.parent
        files = {p.name: p.read_bytes() for p in sorted(inside.iterdir()) if p.is_file()}
        if not path.is_dir():
            files = {path.name: files[path.name]}
        found[name] = Target(files, "" if path.is_dir() else path.name, _read)
    foreign = (
        ("mcap-json", _in_json, partial(_read, sources=_ELSEWHERE)),
        ("mcap-protobuf", _in_protobuf, _pictures_only),
    )
    for name, write, use in foreign:
        path = folder / f"{name}.mcap"
        write(path)
        found[name] = Target({"log.mcap": path.read_bytes()}, "log.mcap", use)
    found["rig.yaml"] = Target({"rig.yaml": RIG.encode()}, "rig.yaml", _rig)
    found["urdf"] = Target({"robot.urdf": urdf_text(PAPER_ROBOT).encode()}, "robot.urdf", _urdf)
    small = _small_extraction()
    extraction = extraction_to_npz(small)
    provenance = Provenance("0", "2026-01-01T00:00:00Z", "ml", small.logs, settings_of(small))
    params = params_yaml(solve(small), small, provenance)
    found["params.yaml"] = Target({"params.yaml": params.encode()}, "params.yaml", _params)
    found["manifest"] = Target({"fleet.yaml": MANIFEST, "rig.yaml": b"{}"}, "fleet.yaml", _manifest)
    found["npz"] = Target({"extraction.npz": extraction}, "extraction.npz", _npz)
    with zipfile.ZipFile(io.BytesIO(extraction)) as archive:
        members = {name: archive.read(name) for name in archive.namelist()}
    found["npz-members"] = Target(members, "extraction.npz", _solved, zipped=True)
    plain = {"enable_crcs": False, "compression": CompressionType.NONE}
    unchecked = r.write_mcap(folder / "unchecked.mcap", items, **plain)
    found["mcap-no-checksums"] = Target({"log.mcap": unchecked.read_bytes()}, "log.mcap", _read)
    found["inspect-no-checksums"] = Target({"log.mcap": unchecked.read_bytes()}, "log.mcap", _glance)
    usual = r.write_mcap(folder / "inspect.mcap", items)
    found["inspect"] = Target({"log.mcap": usual.read_bytes()}, "log.mcap", _glance)
    return found


def place(target: Target, contents: dict[str, bytes], folder: Path) -> Path:
    """Write an input into an empty folder; its path."""
    shutil.rmtree(folder, ignore_errors=True)
    folder.mkdir(parents=True)
    if target.zipped:
        with zipfile.ZipFile(folder / target.path, "w") as archive:
            for name, data in contents.items():
                archive.writestr(name, data)
        return folder / target.path
    for name, data in contents.items():
        (folder / name).write_bytes(data)
    return folder / target.path if target.path else folder
