"""Resolve the rig: flags first, then the file, the recording, and defaults."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass, field, replace
from functools import partial
from typing import Literal, TypeVar, get_args

from mobilecal_cli.errors import ConfigError, RecordingError
from mobilecal_cli.model.rig import CameraInfo, CameraRig, JointSource, Nominal, Rig, Sources, camera_words
from mobilecal_cli.model.signals import RobotDescription
from mobilecal_cli.rig.cameras import are_rectified, camera_rig, image_topics, info_topic
from mobilecal_cli.rig.config import RigConfig, read_urdf
from mobilecal_cli.rig.head import Head, fixed_pose, head_of, joint_sources
from mobilecal_cli.rig.names import of_one_robot
from mobilecal_cli.rig.settings import prior_sigmas
from mobilecal_cli.rig.wheels import wheel_sources

T = TypeVar("T")
#: Parts of a rig that can be unknown, in the order of their errors.
Part = Literal["cameras", "camera infos", "wheels", "head chain", "joints", "priors"]
_Lack = tuple[Part, RecordingError | ConfigError]


@dataclass(slots=True, eq=False)
class Survey:
    """The parts of a rig that configuration and recording determine, and why the others are unknown.

    Attributes:
        config, description: of the configuration and the recording.
        sources: topics of the cameras, the wheels and the head's joints; empty where they are unknown.
        rectified: whether the images are rectified.
        cameras: the cameras.
        head: the head chain.
        notes: remarks for the report.
        lacks: (part, error), in order; none if the rig is complete. A part that is unknown only because of an earlier
            error has none of its own.
        shared: joint → topics, of wheels and of the head's joints that are on several topics and configured on none.
    """

    config: RigConfig
    description: RobotDescription
    sources: Sources
    rectified: bool
    cameras: CameraRig | None
    head: Head | None
    notes: tuple[str, ...]
    lacks: list[_Lack]
    shared: dict[str, tuple[str, ...]] = field(default_factory=dict)

    @property
    def wheel_joints(self) -> set[str]:
        """Joints of the wheels, except those on a configured topic."""
        stated = self.config.wheels.of_sides
        free = [
            w for side, w in self.sources.wheels.items() if not (stated[side].topic or stated[side].topics)
        ]
        return {wheel.joint for each in free for wheel in each.every if wheel.joint}


def complete_rig(survey: Survey) -> Rig:
    """The rig of a survey.

    Raises:
        RecordingError: the recording lacks something that the configuration does not give.
        ConfigError: configuration and recording contradict each other, or several choices remain.
    """
    config, sources, cameras, head = survey.config, survey.sources, survey.cameras, survey.head
    if survey.lacks or cameras is None or head is None:
        raise survey.lacks[0][1]
    chain, drawn, assumed = head.chain, head.drawn, sources.assumed_wheels
    nominal = Nominal(wheels=assumed).over(config.nominal.stated).over(drawn)

    # What each setting is, its key in rig.yaml, and its source if neither a flag nor the file gives it.
    rows = [
        ("board size", "board.columns", "images"),
        ("board square_m", "board.square_m", "stereo"),
        *(
            (f"{name} images {topic}", f"cameras.{name}.image", "log")
            for name, topic in sources.image.items()
        ),
        *(
            (f"{camera_words(name)} info {topic}", f"cameras.{name}.info", "log")
            for name, topic in sources.info.items()
        ),
        (f"images are {'rectified' if cameras.rectified else 'raw'}", "cameras.rectified", "topic name"),
    ]
    if len(sources.image) > 1:
        rows.append((f"reference camera {cameras.reference}", "cameras.reference", "default"))
    if chain.joints:
        rows += [
            (f"joint states {', '.join(sources.joint_topics)}", "joints.topic", "log"),
            (f"pan joint {chain.pan or 'none'}", "joints.pan", "joint name"),
            (f"tilt joint {chain.tilt or 'none'}", "joints.tilt", "joint name"),
            (f"head chain {chain.base_frame} to {chain.head_frame}", "", head.origin),
        ]
    else:
        rows.append((f"camera fixed to {chain.base_frame}", "", head.origin))
    rows += [
        (f"{side} wheel {own.topic} {own.where}", f"wheels.{side}", "log")
        for side, own in sources.wheels.items()
    ]
    rows += [
        ("nominal wheels", "nominal.wheels", "assumed" if assumed else "URDF" if drawn.wheels else "none"),
        ("nominal head_eye", "nominal.head_eye", "none" if drawn.T_h_reference is None else "URDF"),
    ]
    return Rig(
        cameras,
        chain,
        nominal,
        sources,
        {what: config.source_of(key) or otherwise for what, key, otherwise in rows},
        config.noise.model_dump(exclude_none=True),
        prior_sigmas(config.priors, cameras, chain),
    )


def _with_own_frame(name: str, info: CameraInfo, head_frame: str) -> tuple[CameraInfo, tuple[str, ...]]:
    """A camera's info with a frame of its own, and a note if the driver names none.

    Raises:
        ConfigError: the head's frame is the one that the outputs would call the camera's.
    """
    own, camera, named = info.frame_id, camera_words(name), f"{name}_optical_frame"
    if own not in ("", head_frame):
        return info, ()
    if named == head_frame:
        raise ConfigError(
            f"{head_frame} is the frame of the {camera}, not of the head",
            "set head.head_frame to the last link that a joint moves (the base link for a camera on the base)",
        )
    said = f"Neither the images nor the camera info of the {camera} name its optical frame."
    if own:
        said = f"The frame_id of the {camera} is that of the head, {own}."
    return replace(info, frame_id=named), (f"{said} The outputs call its optical frame {named}.",)


def survey_rig(config: RigConfig, description: RobotDescription) -> Survey:
    """Everything that configuration and recording determine, and all errors, except those that follow from another.

    Raises:
        ConfigError: the URDF that the configuration names cannot be read.
    """
    lacks: list[_Lack] = []

    def tried(part: Part, step: Callable[[], T]) -> T | None:
        try:
            return step()
        except (RecordingError, ConfigError) as error:
            lacks.append((part, error))
            return None

    urdf_text = read_urdf(config)
    images = tried("cameras", lambda: image_topics(config, description)) or {}
    configured = (config.joints.topic, config.wheels.left.topic, config.wheels.right.topic)
    of_robot = of_one_robot(description, images.values(), filter(None, configured))
    topics: dict[str, str] = {}
    infos: dict[str, CameraInfo] = {}
    for name, image in images.items():
        topic = tried("camera infos", partial(info_topic, name, image, config, of_robot))
        if topic is not None:
            topics[name], info = topic, of_robot.infos[topic]
            # Some drivers name the optical frame in the images only.
            infos[name] = replace(info, frame_id=info.frame_id or of_robot.image_frames.get(image, ""))
    rectified = tried("cameras", lambda: are_rectified(images, config.cameras.rectified)) or False
    wheels = tried("wheels", lambda: wheel_sources(config, of_robot, images.values())) or {}
    reference = config.cameras.reference or next(iter(images), "")
    frame = infos[reference].frame_id if reference in infos else ""
    head = tried("head chain", lambda: head_of(config, of_robot, urdf_text, wheels, frame))
    notes: tuple[str, ...] = ()
    for name, info in infos.items():
        named = partial(_with_own_frame, name, info, "" if head is None else head.chain.head_frame)
        infos[name], noted = tried("head chain", named) or (info, ())
        notes += noted
    # Which link carries a camera of which nothing is known is no error of its own.
    if images and reference not in infos:
        lacks[:] = [lack for lack in lacks if lack[0] != "head chain" or isinstance(lack[1], RecordingError)]
    cameras: CameraRig | None = None
    if images and len(infos) == len(images):
        drawn = partial(fixed_pose, None) if head is None else head.fixed_pose
        cameras = tried("camera infos", lambda: camera_rig(infos, rectified, config, drawn))
    joints: Mapping[str, JointSource] = {}
    if head is not None:
        wheels, notes = head.wheels, notes + head.notes
        joints = tried("joints", lambda: joint_sources(config, of_robot, head)) or {}
        if cameras is not None:
            tried("priors", lambda: prior_sigmas(config.priors, cameras, head.chain))
    sources = Sources(images, topics, joints, wheels, config.cameras.layout)
    lacks.sort(key=lambda lack: get_args(Part).index(lack[0]))
    survey = Survey(config, description, sources, rectified, cameras, head, notes, lacks)
    of_head = head.chain.joints if head is not None and config.joints.topic is None else ()
    for name in sorted(survey.wheel_joints | {*of_head} - {*sources.elsewhere}):
        on = tuple(topic for topic, names in of_robot.joint_names.items() if name in names)
        if len(on) > 1:
            survey.shared[name] = on
    return survey
