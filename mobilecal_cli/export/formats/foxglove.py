"""A scene as an MCAP file with Foxglove's protobuf messages, and a layout that shows it.

Two JSON topics have numbers for plots. The metadata record "mobilecal" has the verdict of the calibration.
"""

from __future__ import annotations

import io
import json
from collections.abc import Iterable, Sequence
from pathlib import Path
from typing import Any, TypeAlias

import numpy as np
from foxglove_schemas_protobuf.CameraCalibration_pb2 import CameraCalibration
from foxglove_schemas_protobuf.CompressedImage_pb2 import CompressedImage
from foxglove_schemas_protobuf.FrameTransforms_pb2 import FrameTransforms
from foxglove_schemas_protobuf.ImageAnnotations_pb2 import ImageAnnotations
from foxglove_schemas_protobuf.Log_pb2 import Log
from foxglove_schemas_protobuf.PosesInFrame_pb2 import PosesInFrame
from foxglove_schemas_protobuf.SceneUpdate_pb2 import SceneUpdate
from google.protobuf.descriptor_pb2 import FileDescriptorSet
from mcap.writer import Writer

from mobilecal_cli import __version__, se3
from mobilecal_cli.export.board_print import dark_squares
from mobilecal_cli.export.formats import Exported, Source
from mobilecal_cli.export.formats.camera_info import ros_distortion
from mobilecal_cli.export.scene import Motion, Scene
from mobilecal_cli.export.text import rendered
from mobilecal_cli.model.arrays import FloatArray
from mobilecal_cli.model.observations import Corners
from mobilecal_cli.model.rig import Camera

_MOST_POSES = 2000  # of a path
_FRUSTUM_M = 0.15
_GREEN, _RED, _YELLOW = (0.2, 0.9, 0.3, 1.0), (1.0, 0.25, 0.2, 1.0), (1.0, 0.85, 0.2, 1.0)
_DARK, _BLUE = (0.1, 0.1, 0.1, 1.0), (0.2, 0.5, 1.0, 0.9)
#: A protobuf message inside another one: its fields by name, which the types of protobuf do not know.
_Part: TypeAlias = Any
_MODELS = {"equidistant": "kannala_brandt"}  # Foxglove's name, where it differs from that of ROS


def export(of: Source, logs: tuple[Path, ...] = ()) -> Exported:
    """[a scene for Foxglove](../how-to/apply-the-result.md#see-it-in-foxglove-or-rerun) as MCAP, and a layout next to
    it (`--output` is required); `--log RECORDING` adds the images
    """
    # Message times are the stations' and the wheels' times. Images come with annotations of the same time.
    scene, messages = of.scene(logs), _Messages()
    for log, motion in scene.motions.items():
        stations = [k for k, o in enumerate(scene.extraction.observations) if o.log == log]
        _add_frames(messages, scene, motion)
        _add_surroundings(messages, scene, motion, stations)
        for station in stations:
            _add_station(messages, scene, station)
    _add_unused(messages, scene)
    robot = scene.robot
    content = messages.written({"verdict": robot.verdict or "unknown", "reasons": "\n".join(robot.reasons)})
    layout = rendered("foxglove_layout.json", cameras=scene.cameras.names, world=scene.names.world)
    notes = () if logs else ("The file contains no images. Give the recording with --log to add them.",)
    return Exported(content, notes, json.dumps(json.loads(layout), indent=1) + "\n", states_verdict=True)


class _Messages:
    """Messages of all topics, written in order of time."""

    def __init__(self) -> None:
        self._messages: list[tuple[int, str, bytes]] = []
        self._schemas: dict[str, tuple[str, str, bytes]] = {}

    def add(self, topic: str, time_ns: int, message: Any) -> None:  # noqa: ANN401  (any protobuf message)
        """A protobuf message."""
        name = message.DESCRIPTOR.full_name
        if topic not in self._schemas:
            self._schemas[topic] = (name, "protobuf", _with_dependencies(message.DESCRIPTOR.file))
        self._messages.append((time_ns, topic, message.SerializeToString(deterministic=True)))

    def add_json(self, topic: str, time_ns: int, **values: str | float) -> None:
        """A message with named texts and numbers."""
        properties = {
            name: {"type": "string" if isinstance(value, str) else "number"} for name, value in values.items()
        }
        schema = {"title": topic.strip("/"), "type": "object", "properties": properties}
        self._schemas[topic] = (f"mobilecal.{topic.strip('/')}", "jsonschema", json.dumps(schema).encode())
        self._messages.append((time_ns, topic, json.dumps(values, allow_nan=False).encode()))

    def written(self, metadata: dict[str, str]) -> bytes:
        """The file, with one metadata record of the name "mobilecal"."""
        stream = io.BytesIO()
        writer = Writer(stream)
        writer.start(profile="", library=f"mobilecal {__version__}")
        writer.add_metadata("mobilecal", metadata)
        channels = {}
        for topic, schema in self._schemas.items():
            encoding = schema[1].removesuffix("schema")  # of the messages
            channels[topic] = writer.register_channel(topic, encoding, writer.register_schema(*schema))
        for time_ns, topic, data in sorted(self._messages, key=lambda message: message[0]):
            writer.add_message(channels[topic], log_time=time_ns, publish_time=time_ns, data=data)
        writer.finish()  # type: ignore[no-untyped-call]
        return stream.getvalue()


def _with_dependencies(file: Any) -> bytes:  # noqa: ANN401  (a protobuf FileDescriptor)
    """A FileDescriptorSet with a definition and all that it imports, each after what it needs."""
    definitions, done = FileDescriptorSet(), set()

    def add(file: Any) -> None:  # noqa: ANN401
        if file.name not in done:
            done.add(file.name)
            for needed in file.dependencies:
                add(needed)
            file.CopyToProto(definitions.file.add())

    add(file)
    return bytes(definitions.SerializeToString(deterministic=True))


# -- frames and surroundings ----------------------------------------------------------------------


def _add_frames(messages: _Messages, scene: Scene, motion: Motion) -> None:
    """World, base and head over time; the cameras, which are fixed to the head, on a topic of their own."""
    names, start_ns = scene.names, int(motion.time_ns[0])
    fixed = [_transform(start_ns, *frame) for frame in scene.fixed_frames()]
    messages.add("/tf_static", start_ns, FrameTransforms(transforms=fixed))
    for time_ns, T_w_v, T_v_h in zip(motion.time_ns.tolist(), motion.T_w_v, motion.T_v_h, strict=True):
        moving = [_transform(time_ns, names.world, names.base, T_w_v)]
        if names.head != names.base:
            moving.append(_transform(time_ns, names.base, names.head, T_v_h))
        messages.add("/tf", time_ns, FrameTransforms(transforms=moving))


def _add_surroundings(messages: _Messages, scene: Scene, motion: Motion, stations: Sequence[int]) -> None:
    """Path of the base, camera poses and the board: one message each, valid for the whole recording."""
    start_ns, names = int(motion.time_ns[0]), scene.names
    stride = max(1, -(-len(motion.time_ns) // _MOST_POSES))
    path = [_pose(T) for T in motion.T_w_v[::stride]]
    messages.add("/path", start_ns, PosesInFrame(timestamp=_time(start_ns), frame_id=names.world, poses=path))
    entities = [_camera_entity(scene, station, start_ns) for station in stations]
    earlier: _Part = {"timestamp": _time(start_ns), "type": "ALL"}  # another world
    messages.add("/cameras", start_ns, SceneUpdate(deletions=[earlier], entities=entities))
    for name, camera in zip(scene.cameras.names, scene.cameras.each, strict=True):
        info = _calibration(camera, names.cameras[name], start_ns)
        messages.add(f"/camera/{name}/calibration", start_ns, info)
    squares = dark_squares(scene.extraction.board, scene.extraction.square_m)
    both_sides = np.array([0, 1, 2, 0, 2, 3, 3, 2, 0, 2, 1, 0])
    dark: _Part = {
        "pose": _pose(np.eye(4)),
        "points": [_vector(point) for point in squares.reshape(-1, 3)],
        "color": _color(_DARK),
        "indices": (4 * np.arange(len(squares))[:, None] + both_sides).ravel().tolist(),
    }
    board: _Part = {
        "timestamp": _time(start_ns),
        "frame_id": names.board,
        "id": "board",
        "frame_locked": True,
        "triangles": [dark],
    }
    messages.add("/board", start_ns, SceneUpdate(entities=[board]))


def _camera_entity(scene: Scene, station: int, time_ns: int) -> _Part:
    """The first camera at one station as a small pyramid, in the world."""
    camera, tip = scene.cameras.first, np.zeros(3)
    x, y = _FRUSTUM_M * np.array([camera.width / camera.K[0, 0], camera.height / camera.K[1, 1]]) / 2
    rim = np.array([[x, y, _FRUSTUM_M], [-x, y, _FRUSTUM_M], [-x, -y, _FRUSTUM_M], [x, -y, _FRUSTUM_M]])
    segments = [part for k in range(4) for part in (tip, rim[k], rim[k], rim[k - 1])]
    pose, name = _pose(scene.residuals.T_w_c[station]), scene.station_name(station)
    shown = {"pose": pose, "scale_invariant": True, "color": _color(_BLUE)}
    points = [_vector(point) for point in segments]
    return {
        "timestamp": _time(time_ns),
        "frame_id": scene.names.world,
        "id": f"station {name}",
        "lines": [shown | {"type": "LINE_LIST", "thickness": 1.5, "points": points}],
        "texts": [shown | {"billboard": True, "font_size": 12, "text": name}],
    }


def _calibration(camera: Camera, frame: str, time_ns: int) -> CameraCalibration:
    """One camera in its own frame, for the images as recorded."""
    model, D = ros_distortion(camera)
    P = np.hstack([camera.K, np.zeros((3, 1))])
    return CameraCalibration(
        timestamp=_time(time_ns),
        frame_id=frame,
        width=camera.width,
        height=camera.height,
        distortion_model=_MODELS.get(model, model),
        D=D.tolist(),
        K=camera.K.ravel().tolist(),
        R=np.eye(3).ravel().tolist(),
        P=P.ravel().tolist(),
    )


# -- stations -------------------------------------------------------------------------------------


def _add_station(messages: _Messages, scene: Scene, station: int) -> None:
    observation, residuals = scene.extraction.observations[station], scene.residuals
    leg = scene.legs.get(station)
    time_ns, names, images = observation.time_ns, scene.names, scene.images.get(station, {})
    board = _transform(time_ns, names.world, names.board, residuals.T_w_k[station])
    messages.add("/tf_board", time_ns, FrameTransforms(transforms=[board]))
    for k, (name, corners) in enumerate(zip(scene.cameras.names, observation.views, strict=True)):
        predicted = None if leg is None else residuals.predicted_px[k, leg]
        messages.add(f"/camera/{name}/corners", time_ns, _annotations(corners, predicted, time_ns))
        if name in images:
            image = CompressedImage(
                timestamp=_time(time_ns), frame_id=names.cameras[name], data=images[name], format="jpeg"
            )
            messages.add(f"/camera/{name}/image", time_ns, image)
    if leg is not None:
        messages.add_json(
            "/residuals",
            time_ns,
            station=scene.station_name(station),
            to_station=scene.station_name(int(residuals.legs[leg, 1])),
            reprojection_px=float(residuals.leg_reprojection_px[leg]),
            point_mm=1e3 * float(residuals.leg_point_rms_m[leg]),
        )
    messages.add_json("/station", time_ns, state=f"station {scene.station_name(station)}: used")


def _annotations(corners: Corners, predicted_px: FloatArray | None, time_ns: int) -> ImageAnnotations:
    """Detected corners green, predicted ones red, and yellow lines between them."""

    def marks(pixels: FloatArray, color: tuple[float, ...], kind: str, thickness: float) -> _Part:
        points = [{"x": x + 0.5, "y": y + 0.5} for x, y in pixels.tolist()]  # from the first pixel's corner
        look = {"outline_color": _color(color), "thickness": thickness}
        return {"timestamp": _time(time_ns), "type": kind, "points": points, **look}

    detected = corners.pixels[corners.seen]
    marked = [marks(detected, _GREEN, "POINTS", 4.0)]
    if predicted_px is not None:
        predicted = predicted_px[corners.seen]
        pairs = np.stack([detected, predicted], axis=1).reshape(-1, 2)
        marked.append(marks(pairs, _YELLOW, "LINE_LIST", 1.0))
        marked.append(marks(predicted, _RED, "POINTS", 3.0))
    return ImageAnnotations(points=marked)


def _add_unused(messages: _Messages, scene: Scene) -> None:
    """Rejected images, stations and intervals as log messages, and as states at their start and end."""
    for item in scene.unused:
        end = f" ({(item.end_ns - item.start_ns) * 1e-9:.2f} s)" if item.end_ns > item.start_ns else ""
        log = Log(
            timestamp=_time(item.start_ns),
            level=Log.WARNING,
            name="mobilecal",
            message=f"{item.what}{end}: {item.text}",
        )
        messages.add("/rejected", item.start_ns, log)
        messages.add_json("/station", item.start_ns, state=f"rejected: {item.what}")
        if item.end_ns > item.start_ns:
            messages.add_json("/station", item.end_ns, state="end of the rejected interval")


# -- values ---------------------------------------------------------------------------------------


def _time(time_ns: int) -> _Part:
    return {"seconds": time_ns // 10**9, "nanos": time_ns % 10**9}


def _color(rgba: Iterable[float]) -> _Part:
    return dict(zip("rgba", rgba, strict=True))


def _vector(p: FloatArray) -> _Part:
    return dict(zip("xyz", p.tolist(), strict=True))


def _quaternion(R: FloatArray) -> _Part:
    return dict(zip("xyzw", se3.quaternion_xyzw(R).tolist(), strict=True))


def _pose(T: FloatArray) -> _Part:
    return {"position": _vector(T[:3, 3]), "orientation": _quaternion(T[:3, :3])}


def _transform(time_ns: int, parent: str, child: str, T_parent_child: FloatArray) -> _Part:
    return {
        "timestamp": _time(time_ns),
        "parent_frame_id": parent,
        "child_frame_id": child,
        "translation": _vector(T_parent_child[:3, 3]),
        "rotation": _quaternion(T_parent_child[:3, :3]),
    }
