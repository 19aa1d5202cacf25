"""What the whole command says about input that cannot be used: the table docs/validation/refusals.md, and its test."""

import io
import os
import shutil
import zipfile
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from functools import cache
from pathlib import Path
from typing import Any

import cv2
import numpy as np
from PIL import Image
from rosbags.rosbag2 import Writer

from mobilecal_cli.export.extraction import extraction_to_npz
from mobilecal_cli.export.params import FIRST_LINE
from mobilecal_cli.model.observations import LogSource
from tests.commands.edited import STORE, edited
from tests.conftest import REPOSITORY
from tests.extractions import Noise, simulated
from tests.readers.recordings import in_sqlite
from tests.records import records_of, written

LOGS = REPOSITORY / "sample_logs"
LOG = LOGS / "paper_robot.mcap"
IMAGES = ("/stereo/left/image_raw/compressed", "/stereo/right/image_raw/compressed")
NOISE = Noise(pixel_px=0.1, wheel_rad_per_sqrt_rad=0.002, joint_rad=2e-4)
Make = Callable[[Path], None]


def nothing(folder: Path) -> None:
    """A case that needs no file of its own."""


@dataclass(frozen=True)
class Case:
    """One input, and what must be said.

    Attributes:
        name: the input, as in the table.
        arguments: of the command.
        code: its exit code.
        says: part of the first line on standard error (of standard output for code 0).
        make: writes the files of the case into its directory.
        environment: variables.
    """

    name: str
    arguments: tuple[object, ...]
    code: int
    says: str
    make: Make = nothing
    environment: Mapping[str, str] = field(default_factory=dict)


@cache
def _extraction() -> bytes:
    made = replace(simulated("standard", NOISE, seed=0), logs=(LogSource("log.mcap", "0" * 64),))
    return extraction_to_npz(made)


def extraction(folder: Path) -> None:
    """extraction.npz of a simulated robot."""
    (folder / "e.npz").write_bytes(_extraction())


def result(folder: Path) -> None:
    """What is left of an output directory of mobilecal."""
    (folder / "out").mkdir()
    (folder / "out" / "extraction.npz").write_bytes(_extraction())
    (folder / "out" / "params.yaml").write_text(FIRST_LINE)


def text(name: str, content: str) -> Make:
    """A text file."""
    return lambda folder: Path(folder, name).write_text(content) and None


def log(edit: Callable[[str, Any], Any]) -> Make:
    """A copy of the sample recording with an edit, as log.mcap."""
    return lambda folder: edited(LOG, folder / "log.mcap", edit) and None


def pictures(data: Callable[[], bytes]) -> Make:
    """The sample recording with other images."""

    def make(folder: Path) -> None:
        image = np.frombuffer(data(), np.uint8)
        log(lambda topic, m: replace(m, data=image) if topic in IMAGES else m)(folder)

    return make


def pixels(topics: Sequence[str], change: Callable[[Any], Any]) -> Make:
    """The sample recording with changed pixels."""

    def edit(topic: str, message: Any) -> Any:
        if topic not in topics:
            return message
        image = change(cv2.imdecode(np.asarray(message.data), cv2.IMREAD_GRAYSCALE))
        return replace(message, data=cv2.imencode(".jpg", np.ascontiguousarray(image))[1].reshape(-1))

    return log(edit)


def urdf(old: str, new: str) -> Make:
    """The sample recording with another URDF."""

    def edit(topic: str, message: Any) -> Any:
        if topic != "/robot_description":
            return message
        assert old in message.data
        return replace(message, data=message.data.replace(old, new))

    return log(edit)


def positions(**values: float) -> Make:
    """The sample recording with a reading in place of those of some joints, in every second message."""
    count = [0]

    def edit(topic: str, message: Any) -> Any:
        if topic != "/joint_states":
            return message
        count[0] += 1
        position = message.position.copy()
        for name, value in values.items():
            if count[0] % 2:
                position[list(message.name).index(name)] = value
        return replace(message, position=position)

    return log(edit)


def infos(**changes: Callable[[Any], Any]) -> Make:
    """The sample recording with other fields in the camera infos."""

    def edit(topic: str, message: Any) -> Any:
        if not hasattr(message, "k"):
            return message
        return replace(message, **{name: change(getattr(message, name)) for name, change in changes.items()})

    return log(edit)


def at(place: int, value: float) -> Callable[[Any], Any]:
    """An array with another value at one place."""
    return lambda was: np.where(np.arange(len(was)) == place, value, was)


def database(statement: str) -> Make:
    """The sample recording as rosbag2 SQLite, changed by a statement."""

    def make(folder: Path) -> None:
        connections: dict[str, Any] = {}
        with Writer(folder / "bag", version=9) as writer:
            for record in records_of(LOG):
                if record.topic not in connections:
                    connections[record.topic] = writer.add_connection(
                        record.topic, record.type, typestore=STORE
                    )
                writer.write(connections[record.topic], record.time_ns, record.data)
        (path,) = (folder / "bag").glob("*.db3")
        in_sqlite(path, statement)

    return make


def far_future(folder: Path) -> None:
    """The sample recording with log times beyond 2^63 ns."""
    late = (replace(record, time_ns=record.time_ns + 2**63, publish_ns=0) for record in records_of(LOG))
    written(folder / "log.mcap", late)


def repeated_metadata(folder: Path) -> None:
    """A rosbag2 directory whose metadata.yaml names its one file 6,000 times."""
    (folder / "bag").mkdir()
    shutil.copy(LOG, folder / "bag/log.mcap")
    names = ", ".join(["log.mcap"] * 6000)
    text("bag/metadata.yaml", f"rosbag2_bagfile_information:\n  relative_file_paths: [{names}]\n")(folder)


def webp() -> bytes:
    """A gray image that Pillow writes as WebP."""
    stream = io.BytesIO()
    Image.new("L", (640, 480), 120).save(stream, "WEBP")
    return stream.getvalue()


def fifo(folder: Path) -> None:
    """A named pipe."""
    os.mkfifo(folder / "fifo.mcap")


def zipped(folder: Path) -> None:
    """A zip archive of a recording."""
    with zipfile.ZipFile(folder / "log.zip", "w") as archive:
        archive.writestr("log.mcap", b"\x89MCAP0\r\n")


def tall_jpeg() -> bytes:
    """A JPEG of 1 x 65500 pixels."""
    return bytes(cv2.imencode(".jpg", np.zeros((65500, 1), np.uint8))[1])


def large_png() -> bytes:
    """A PNG of 8190 x 8190 pixels."""
    return bytes(cv2.imencode(".png", np.zeros((8190, 8190), np.uint8))[1])


SOLVE = ("calibrate", "e.npz", "-o", "out")
READ = ("calibrate", "log.mcap", "-o", "out")
BAG = ("calibrate", "bag", "-o", "out")
LINEAR = ("--method", "linear")  # fast, where the input alone matters
RIG = ("calibrate", LOG, "--config", "rig.yaml", "-o", "out")

CASES = (
    Case("`--square-m inf`", ("calibrate", LOG, "--square-m", "inf"), 2, "board.square_m: must be from 0.0001 to 10 m"),
    Case("`--square-m 80`, millimeters", ("calibrate", LOG, "--square-m", "80"), 2, "80 looks like millimeters: 0.08 m"),
    Case("`--square-m 8`, centimeters", ("calibrate", LOG, "--square-m", "8"), 4, "the squares are 0.08 m wide at the median of 12 measurements, but board.square_m is 8 m"),
    Case(
        "`nominal.wheels` in millimeters", RIG, 2, "nominal.wheels.radius_left_m: must be from 0.001 to 10 m; 97.5 looks like millimeters: 0.0975 m",
        text("rig.yaml", "nominal: {wheels: {radius_left_m: 97.5, radius_right_m: 0.1, separation_m: 0.5}}"),
    ),
    Case("`--fix radius_left=0`", (*SOLVE, "--fix", "radius_left=0"), 2, "0 m is not possible (range 0.001 to 10 m)", extraction),
    Case("`--fix square_scale=0.08`, the size in meters", (*SOLVE, "--fix", "square_scale=0.08"), 2, "0.08 of the stated value is not possible (range -0.02 to 0.02", extraction),
    Case("`--fix pan_zero=5`, degrees", (*SOLVE, "--fix", "pan_zero=5"), 2, "5 looks like degrees: 0.08727 rad", extraction),
    Case(
        "`--prior t_x=0.1±1e-300`", (*SOLVE, "--prior", "t_x=0.1±1e-300"), 2,
        "standard deviation: 1e-300 is not possible (range 1e-09 to 10000)", extraction,
    ),
    Case("`SOURCE_DATE_EPOCH` is a word", SOLVE, 2, "SOURCE_DATE_EPOCH", extraction, {"SOURCE_DATE_EPOCH": "today"}),
    Case("`SOURCE_DATE_EPOCH` is empty: the time is used", SOLVE, 0, "PASS", extraction, {"SOURCE_DATE_EPOCH": ""}),
    Case(
        "both wheels are the same joint", ("calibrate", LOG, "--set", "wheels.left.joint=wheel_right_joint", "-o", "out"), 2,
        "wheels.left and wheels.right are both read from wheel_right_joint",
    ),
    Case(
        "pan and tilt are the same joint", ("calibrate", LOG, "--set", "joints.pan=head_pan_joint", "--set", "joints.tilt=head_pan_joint"), 2,
        "joints.pan and joints.tilt are both 'head_pan_joint'",
    ),
    Case(
        "the pan joint is not in the head chain", ("calibrate", LOG, "--set", "joints.pan=head_pan"), 2,
        "joints.pan: no joint 'head_pan' in the head chain",
    ),
    Case(
        "both cameras are one topic",
        ("calibrate", LOG, *(f"--set=cameras.{side}.image={IMAGES[0]}" for side in ("left", "right"))), 2,
        "cameras.left.image and cameras.right.image are both",
    ),
    Case("a joint reads 1e300 in every second message: dropped", (*READ, *LINEAR), 0, "PASS", positions(head_pan_joint=1e300)),
    Case("a URDF with a wheel radius of 1e-300 m", READ, 2, "cylinder radius: 1e-300 m is not possible", urdf('radius="0.225"', 'radius="1e-300"')),
    Case("a URDF with an origin at 1e300 m", READ, 2, "origin xyz: 1e+300 m is not possible", urdf('xyz="0.04 0.0', 'xyz="1e300 0.0')),
    Case("JPEG images of 1 x 65500 pixels", READ, 3, "images are 1 x 65500 pixels, but their camera_info states 640 x 480", pictures(tall_jpeg)),
    Case("the left images are mirrored", READ, 4, "the images of the left camera are mirrored", pixels(IMAGES[:1], lambda p: p[:, ::-1])),
    Case("PNG images of 8190 x 8190 pixels", READ, 3, "image size 8190x8190 exceeds the limit", pictures(large_png)),
    Case("WebP images", READ, 3, "that begin with b'RIFF", pictures(webp)),
    Case("WebP images, with `--board`", (*READ, "--board", "8x6"), 3, "that begin with b'RIFF", pictures(webp)),
    Case("log times beyond 2^63 ns", READ, 3, "/stereo/left/camera_info: none of its 24 messages can be read", far_future),
    Case("text for times in a database", BAG, 3, "/stereo/left/camera_info: none of its 24 messages can be read", database("UPDATE messages SET timestamp='late'")),
    Case("text for messages in a database", BAG, 3, "/stereo/left/camera_info: none of its 24 messages can be read", database("UPDATE messages SET data='text'")),
    Case("metadata.yaml names one file 6,000 times: read once", (*BAG, *LINEAR), 0, "PASS", repeated_metadata),
    Case("camera_info: distortion model `double_sphere`", READ, 3, "unknown distortion model 'double_sphere'", infos(distortion_model=lambda _: "double_sphere")),
    Case("camera_info: a focal length of 1e-9 px", READ, 3, "K: fx is 1e-09 (range 1 to 1e+06 px)", infos(k=at(0, 1e-9))),
    Case("camera_info: fy 10 times fx", READ, 3, "K: fx / fy is 0.1", infos(k=lambda k: at(4, 10 * k[0])(k))),
    Case("camera_info: principal point at -5000 px", READ, 3, "K: principal point cx over the image size 640 is -7.8125", infos(k=at(2, -5000.0))),
    Case("camera_info: K of an image of half the size", READ, 3, "in K is the middle of an image of about", infos(k=lambda k: k * np.repeat([0.5, 1.0], [6, 3]))),
    Case("camera_info: skew of 500 px", READ, 3, "K is not of the form", infos(k=at(1, 500.0))),
    Case("camera_info: k1 = 50", READ, 3, "D moves a point half way to the edge", infos(d=lambda _: np.array([50.0, 0, 0, 0, 0]))),
    Case("camera_info: R is no rotation", READ, 3, "R is not a rotation matrix", infos(r=lambda r: 2 * r)),
    Case("camera_info: P with a tenth of the focal length of K", READ, 3, "focal length fx in P over that in K is 0.1", infos(p=lambda p: at(0, 0.1 * p[0])(at(5, 0.1 * p[5])(p)))),
    Case("camera_info: a baseline in millimeters", READ, 3, "the stereo baseline in camera_info is 120 m (range 0.0001 to 5 m)", infos(p=lambda p: at(3, 1e3 * p[3])(p))),
    Case("camera_info: image size 0", READ, 2, "the image size is 0 x 0 pixels", infos(width=lambda _: 0, height=lambda _: 0)),
    Case("a named pipe as the recording", ("calibrate", "fifo.mcap"), 3, "fifo.mcap: not a regular file", fifo),
    Case("a named pipe as the URDF", ("init", LOG, "--urdf", "fifo.mcap"), 2, "fifo.mcap: cannot be read: not a regular file", fifo),
    Case("`--hold-out 25`, percent", (*SOLVE, "--hold-out", "25"), 2, "--hold-out: 25 of the stations is not possible (range 0.0001 to 0.8 of the stations)", extraction),
    Case("`--square-m abc`", ("calibrate", LOG, "--square-m", "abc"), 2, "error: --square-m: must be a valid number (got 'abc')"),
    Case("an unknown format", ("export", "params.yaml", "--to", "csv"), 2, "error: --to: 'csv' is not one of 'camchain', 'camera_info',"),
    Case("an unknown option", ("calibrate", LOG, "--foo"), 2, "error: no such option: --foo"),
    Case("an unknown command", ("calibrat", LOG), 2, "error: no such command 'calibrat'. Did you mean 'calibrate'?"),
    Case("no recording", ("calibrate",), 2, "error: missing argument 'logs'"),
    Case("a recording as the configuration", ("calibrate", LOG, "--config", LOG), 2, ": a recording, not a rig.yaml"),
    Case("`evaluate` with swapped arguments", ("evaluate", "params.yaml", LOG), 2, ": a recording, not a params.yaml"),
    Case("`compare` with a recording", ("compare", LOG, LOG), 2, ": a recording, not a params.yaml"),
    Case("`export` of a directory", ("export", ".", "--to", "json"), 2, ".: a directory, not a params.yaml"),
    Case("`export` of report.json", ("export", "report.json", "--to", "json"), 2, "report.json: larger than 131072 bytes, so not a params.yaml", text("report.json", " " * 200_000)),
    Case("`batch` with a recording", ("batch", LOG, "-o", "out"), 2, ": a recording, not a manifest"),
    Case("`batch` with a rig.yaml", ("batch", "rig.yaml", "-o", "out"), 2, "rig.yaml: not a manifest: it has no key robots", text("rig.yaml", "wheels: {}")),
    Case("a zipped recording", ("calibrate", "log.zip"), 3, "log.zip: a zip archive, but not an extraction", zipped),
    Case("a directory with an extraction alone", ("calibrate", "."), 3, ".: a directory without a recording", lambda folder: (folder / "extraction.npz").write_bytes(b"PK") and None),
    Case("rig.yaml in UTF-16", RIG, 2, "rig.yaml: not UTF-8 text (but UTF-16)", lambda folder: Path(folder, "rig.yaml").write_text("board: {}", encoding="utf-16") and None),
    Case("an image as the URDF", ("init", LOG, "--urdf", "a.urdf"), 2, "a.urdf: not UTF-8 text (byte 0)", lambda folder: Path(folder, "a.urdf").write_bytes(b"\x89PNG") and None),
    Case("a web page as the URDF", ("calibrate", LOG, "--set", "head.urdf=a.urdf"), 2, "URDF: not valid XML: it has a document type; it begins with '<!DOCTYPE html>", lambda folder: Path(folder, "a.urdf").write_text("<!DOCTYPE html><html>\n") and None),
    Case("a setting twice", ("calibrate", LOG, "--set", "board.rows=6", "--set", "board.rows=5"), 2, "--set board.rows: given twice, as 6 and 5"),
    Case("one recording twice", ("calibrate", LOG, LOG), 2, "paper_robot.mcap is given twice"),
    Case("one recording twice, `inspect`", ("inspect", LOG, LOG), 2, "paper_robot.mcap is given twice"),
    Case("an empty argument", ("calibrate", ""), 2, "an argument is empty"),
    Case("`suggest` with an unknown gate", ("suggest", "e.npz", "--set", "gates.foo=1"), 2, "gates.foo: unknown figure", extraction),
    Case("no format", ("export", "params.yaml"), 2, "Choose from: camchain, camera_info,"),
    Case("a device as the recording", ("calibrate", "/dev/null"), 3, "/dev/null: not a regular file"),
    Case("`--hold-out 0.7` of 12 stations", (*SOLVE, "--hold-out", "0.7"), 4, "--hold-out 0.7 leaves 3 of 12 stations, with 2 legs between them; at least 3 legs are needed", extraction),
    Case("a key twice in rig.yaml", RIG, 2, "line 2, column 1: found duplicate key \"board\"", text("rig.yaml", "board: {}\nboard: {}\n")),
    Case("the side of a square in millimeters, and the board exists", ("board", "--corners", "8x5", "--square", "80"), 2, "80 looks like millimeters: 0.08 m", text("board.pdf", "")),
    Case("a simulated recording with another suffix", ("simulate", "foo.txt"), 2, "foo.txt: .txt is not the suffix of a recording"),
    Case("`export` of two formats", ("export", "params.yaml", "--to", "xacro", "--to", "json"), 2, "--to xacro --to json: more than one format"),
    Case("the output exists", (*SOLVE,), 7, "out: already exists", lambda folder: (extraction(folder), (folder / "out").mkdir(), None)[-1]),
    Case("the output is the directory that is read", ("calibrate", "out/extraction.npz", "-o", "out", "--force"), 7, "out: this command reads out/extraction.npz", result),
    Case("the directory of the JUnit file does not exist", (*SOLVE, "--junit", "no/j.xml"), 7, "no is not a directory", extraction),
    Case("the JUnit file is inside the output", (*SOLVE, "--junit", "out/j.xml"), 7, "--junit out/j.xml: inside --output out", extraction),
    Case("JUnit on standard output", (*SOLVE, "--junit", "-"), 7, "-: not a name for this output", extraction),
    Case("one file for JUnit and the summary", (*SOLVE, "--junit", "j.xml", "--summary", "./j.xml"), 7, "--junit j.xml: also the path of --summary", extraction),
    Case("JUnit in place of the table of all robots", ("batch", ".", "-o", "out", "--junit", "out/summary.csv"), 7, "--junit out/summary.csv: also the path of summary.csv"),
)  # fmt: skip


def table() -> str:
    """The page docs/validation/refusals.md."""
    lines = [
        "# Refusals",
        "",
        "Generated from the tests by `make docs`: input that cannot be used, the exit code, and a part of the",
        "message. Each line is a test of the whole command (`tests/hostile/test_refusals.py`).",
        "",
        "| case | exit code | message contains |",
        "| --- | --- | --- |",
    ]
    lines += [f"| {case.name} | {case.code} | {case.says.replace('|', '/')} |" for case in CASES]
    return "\n".join(lines) + "\n"
