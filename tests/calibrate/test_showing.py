"""The scene for Foxglove: read by Foxglove's and MCAP's own packages, and its frames against the calibration."""

import io
import json
import shutil
from dataclasses import replace

import cv2
import foxglove_schemas_protobuf
import jsonschema
import numpy as np
import pytest
from google.protobuf.descriptor_pb2 import FileDescriptorSet
from mcap.reader import make_reader
from mcap_protobuf.decoder import DecoderFactory
from pytransform3d.rotations import matrix_from_quaternion
from pytransform3d.transformations import concat, transform_from

import mobilecal_cli as mc
from mobilecal_cli.errors import ConfigError
from mobilecal_cli.export.extraction import extraction_from_npz, extraction_to_npz
from mobilecal_cli.model.calibration import Parameters
from mobilecal_cli.model.signals import Rejection
from mobilecal_cli.solvers.residuals import at_constants
from mobilecal_cli.vision import Detection, find_board
from tests.command import run, succeeded

IMAGES = ("left", "right")


@pytest.fixture(scope="module")
def result(sample_logs, tmp_path_factory):
    """A calibration of a robot that is not as described: its cameras and head chain have estimated constants."""
    log, folder = sample_logs / "imperfect_robot.mcap", tmp_path_factory.mktemp("showing") / "result"
    data = mc.extract(log)
    mc.Report(data, mc.solve(data)).save(folder)
    return folder


@pytest.fixture(scope="module")
def exported(result, sample_logs):
    return mc.export_to(result / "params.yaml", "foxglove", logs=sample_logs / "imperfect_robot.mcap")


@pytest.fixture(scope="module")
def messages(exported):
    return read(exported.content)


@pytest.fixture(scope="module")
def extraction(result):
    return extraction_from_npz(result / "extraction.npz")


def read(content):
    """Topic → [(time, message)], decoded with the definitions in the file."""
    found = {}
    reader = make_reader(io.BytesIO(content), decoder_factories=[DecoderFactory()])
    for schema, channel, message in reader.iter_messages():
        if channel.message_encoding == "json":
            value = json.loads(message.data)
            jsonschema.validate(value, json.loads(schema.data) | {"additionalProperties": False})
        else:
            value = DecoderFactory().decoder_for(channel.message_encoding, schema)(message.data)
        found.setdefault(channel.topic, []).append((message.log_time, value))
    return found


def matrix(translation, rotation):
    R = matrix_from_quaternion([rotation.w, rotation.x, rotation.y, rotation.z])
    return transform_from(R, [translation.x, translation.y, translation.z])


def frames_at(messages, time_ns):
    """(parent, child) → transform, the last ones up to a time."""
    found = {}
    for topic in ("/tf_static", "/tf", "/tf_board"):
        for time, value in messages[topic]:
            if time <= time_ns:
                for one in value.transforms:
                    T = matrix(one.translation, one.rotation)
                    found[one.parent_frame_id, one.child_frame_id] = T
    return found


def test_every_schema_is_foxglove_s_own(exported):
    """The definitions in the file against those of the installed package, field by field."""
    summary = make_reader(io.BytesIO(exported.content)).get_summary()
    assert summary.statistics.message_count > 100
    names = set()
    for schema in summary.schemas.values():
        if schema.encoding != "protobuf":
            assert schema.name in ("mobilecal.residuals", "mobilecal.station")
            jsonschema.Draft202012Validator.check_schema(json.loads(schema.data))
            continue
        package, name = schema.name.split(".")
        module = __import__(f"{foxglove_schemas_protobuf.__name__}.{name}_pb2", fromlist=["DESCRIPTOR"])
        files = {file.name: file for file in FileDescriptorSet.FromString(schema.data).file}
        own = type(next(iter(files.values())))()
        module.DESCRIPTOR.CopyToProto(own)
        assert package == "foxglove"
        assert files[module.DESCRIPTOR.name] == own
        names.add(name)
    assert names == {
        "CameraCalibration", "CompressedImage", "FrameTransforms", "ImageAnnotations", "PosesInFrame", "SceneUpdate",
    }  # fmt: skip


def test_the_frames_compose_to_the_parameters(result, messages, extraction):
    """Head-eye as in params.yaml; camera, base and board at every station; wheels from the turn of the base."""
    robot, rig = mc.load(result / "params.yaml"), extraction.rig
    turned, rolled = [], []
    last = None
    pairs = at_constants(extraction, Parameters(robot.T_parent_child, robot.wheels), robot.constants).pairs
    for o, T_c_k in zip(extraction.observations, pairs.T_c_k, strict=True):
        frames = frames_at(messages, o.time_ns)
        T_h_c = frames[robot.parent_frame, robot.child_frame]
        assert T_h_c == pytest.approx(robot.T_parent_child, abs=1e-12)
        T_w_v, T_v_h = frames["world", rig.chain.base_frame], frames[rig.chain.base_frame, robot.parent_frame]
        T_w_k = frames["world", "board"]
        T_w_c = concat(T_h_c, concat(T_v_h, T_w_v))  # pytransform3d applies the first one first
        assert np.linalg.inv(T_w_c) @ T_w_k == pytest.approx(T_c_k, abs=1e-9)
        if last is not None:
            before, base = last
            apart = np.linalg.inv(base) @ T_w_v
            turned.append(np.arctan2(apart[1, 0], apart[0, 0]))
            track = extraction.wheels[0]
            times_ns = np.array([before, o.time_ns])
            rolled.append([wheel.at(times_ns) @ [-1, 1] for wheel in (track.right, track.left)])
        last = o.time_ns, T_w_v
    right, left = np.array(rolled).T
    wheels = robot.wheels
    expected = (wheels.radius_right_m * right - wheels.radius_left_m * left) / wheels.separation_m
    assert np.sin(np.array(turned) - expected) == pytest.approx(0, abs=1e-9)
    assert np.ptp(turned) > 0.5


def test_the_marks_are_on_the_corners_of_the_images(messages, extraction):
    """A new search in the exported images; marks count from the corner of the first pixel, detections from its center."""
    for side in IMAGES:
        images, corners = dict(messages[f"/camera/{side}/image"]), dict(messages[f"/camera/{side}/corners"])
        assert set(images) == set(corners) == {o.time_ns for o in extraction.observations}
        found = 0
        for time_ns in sorted(images)[:4]:
            assert images[time_ns].format == "jpeg"
            picture = cv2.imdecode(np.frombuffer(images[time_ns].data, np.uint8), cv2.IMREAD_GRAYSCALE)
            search = find_board(picture, extraction.board)
            if not isinstance(search, Detection):
                continue
            found += 1
            detected = np.array([[p.x, p.y] for p in corners[time_ns].points[0].points]) - 0.5
            off = np.linalg.norm(search.pixels[:, None] - detected, axis=-1).min(axis=0)
            assert np.median(off) < 0.2
        assert found >= 3


def test_the_residuals_are_those_of_the_report(result, messages):
    legs = json.loads((result / "report.json").read_text())["legs"]
    shown = [value for _, value in messages["/residuals"]]
    for name, of_leg in (("reprojection_px", "reprojection_px"), ("point_mm", "point_rms_mm")):
        # The report leaves out what each image has of its own.
        assert [one[name] for one in shown] == pytest.approx([leg[of_leg] for leg in legs], rel=0.01)
    drawn = [corners for _, corners in messages["/camera/left/corners"] if len(corners.points) == 3]
    assert len(drawn) == len(legs)
    lines = np.array([[p.x, p.y] for p in drawn[0].points[1].points]).reshape(-1, 2, 2)
    off = np.linalg.norm(lines[:, 0] - lines[:, 1], axis=1)
    assert np.sqrt(np.mean(off**2)) == pytest.approx(shown[0]["reprojection_px"], rel=0.5)


def test_the_scene_shows_board_cameras_and_path(messages, extraction):
    (_, board), (_, cameras), (_, path) = (messages[topic][0] for topic in ("/board", "/cameras", "/path"))
    assert board.entities[0].frame_id == "board"
    points = np.array([[p.x, p.y, p.z] for p in board.entities[0].triangles[0].points])
    size = [extraction.board.columns + 1, extraction.board.rows + 1, 0]
    square_m = np.median([o.square_m for o in extraction.observations])  # not stated: measured
    assert np.ptp(points, axis=0) == pytest.approx(np.array(size) * square_m)
    assert len(cameras.entities) == len(extraction.observations)
    assert [one.type for one in cameras.deletions] == [1]  # all: an earlier recording has another world
    assert len(path.poses) == len(messages["/tf"])
    assert path.frame_id == "world"


def test_the_layout_shows_topics_of_the_file(exported, messages):
    """The panels exist and show topics and fields of the file."""
    layout = json.loads(exported.layout)
    panels = layout["configById"]

    def leaves(node):
        return [node] if isinstance(node, str) else leaves(node["first"]) + leaves(node["second"])

    assert sorted(leaves(layout["layout"])) == sorted(panels)
    for side in IMAGES:
        mode = panels[f"Image!{side}"]["imageMode"]
        assert {mode["imageTopic"], mode["calibrationTopic"], *mode["annotations"]} <= set(messages)
    assert set(panels["3D!scene"]["topics"]) <= set(messages)
    for panel in ("Plot!px", "Plot!mm", "StateTransitions!station"):
        topic, _, field = panels[panel]["paths"][0]["value"].partition(".")
        assert field in messages[topic][0][1]


def test_outliers_and_rejections_are_shown_with_their_interval(result, extraction, tmp_path):
    """A slip between two stations, and a rejected image; the leg of the slip has no prediction."""
    copy = tmp_path / "result"
    shutil.copytree(result, copy)
    report = json.loads((copy / "report.json").read_text())
    first, second = extraction.observations[4:6]
    slip = {"kind": "slip", "log": 0, "observations": [4, 5], "time_ns": first.time_ns}
    report["outliers"] = [slip | {"text": "A wheel slips."}]
    report["legs"] = [leg for leg in report["legs"] if leg["from_observation"] != 4]
    (copy / "report.json").write_text(json.dumps(report))
    rejected = Rejection("vision", "no board found", "no grid", first.time_ns + 10**8, -1, 0)
    (copy / "extraction.npz").write_bytes(extraction_to_npz(replace(extraction, rejections=(rejected,))))
    exported = mc.export_to(copy / "params.yaml", "foxglove")
    assert exported.notes == ("The file contains no images. Give the recording with --log to add them.",)
    found = read(exported.content)
    span_s = (second.time_ns - first.time_ns) * 1e-9
    assert [(time, log.level, log.message) for time, log in found["/rejected"]] == [
        (first.time_ns, 3, f"outlier (slip) ({span_s:.2f} s): A wheel slips."),
        (rejected.time_ns, 3, "no board found: no grid"),
    ]
    states = [value["state"] for time, value in found["/station"] if first.time_ns <= time < second.time_ns]
    assert states == ["station 4: used", "rejected: outlier (slip)", "rejected: no board found"]
    assert len(found["/residuals"]) == len(report["legs"])
    assert "/camera/left/image" not in found


def test_the_command_writes_both_files_and_refuses_what_does_not_belong(result, tmp_path, sample_logs):
    out, params = tmp_path / "scene.mcap", result / "params.yaml"
    arguments = ["export", params, "--to", "foxglove"]
    succeeded(*arguments, "--output", out)
    assert out.read_bytes()[:5] == b"\x89MCAP"
    assert "configById" in json.loads((tmp_path / "scene.layout.json").read_text())
    assert run(*arguments, "--output", out).code == 7  # both exist
    with pytest.raises(ConfigError, match="not a recording of this calibration"):
        mc.export_to(params, "foxglove", logs=sample_logs / "paper_robot.mcap")
    assert "writes two files" in run(*arguments).err
    copy = tmp_path / "result"
    shutil.copytree(result, copy)
    (copy / "report.json").write_text("[]")
    with pytest.raises(ConfigError, match=r"not a report\.json of mobilecal"):
        mc.export_to(copy / "params.yaml", "foxglove")
