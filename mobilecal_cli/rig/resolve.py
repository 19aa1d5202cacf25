"""Resolve the rig: flags first, then the file, the recording, and defaults."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping
from dataclasses import dataclass, field, replace
from functools import partial
from typing import Literal, TypeVar

from mobilecal_cli.errors import ConfigError, RecordingError
from mobilecal_cli.model import (
    CameraInfo,
    CameraRig,
    JointField,
    JointTransform,
    Nominal,
    Rig,
    RobotDescription,
    Side,
    Sources,
    WheelSource,
    camera_words,
)
from mobilecal_cli.rig.cameras import are_rectified, camera_rig, image_topics, info_topic, optical_frame
from mobilecal_cli.rig.config import RigConfig, read_urdf
from mobilecal_cli.rig.head import Head, fixed_pose, head_of, joint_sources
from mobilecal_cli.rig.names import of_one_robot
from mobilecal_cli.rig.settings import prior_sigmas
from mobilecal_cli.rig.wheels import as_drawn, wheel_sources

T = TypeVar("T")
_Lack = RecordingError | ConfigError
#: Parts of a rig that can be unknown.
Part = Literal["cameras", "camera infos", "wheels", "head chain", "joints", "priors"]


@dataclass(slots=True, eq=False)
class Survey:
    """The parts of a rig that configuration and recording determine, and why the others are unknown.

    `survey_rig` fills it in.

    Attributes:
        config, description: of the configuration and the recording.
        images, infos: topics of each camera.
        rectified: whether the images are rectified.
        cameras: the cameras.
        wheels: source of each wheel's rotation.
        head: the head chain.
        joints, elsewhere: JointState topics, and the sources of the head's joints that are not on them.
        shared: joint → topics, of wheels and of the head's joints that are on several topics and configured on none.
        notes: remarks for the report.
        lacks: (part, error), in order; none if the rig is complete. A part that is unknown only because of an earlier
            error has none of its own.
    """

    config: RigConfig
    description: RobotDescription
    images: dict[str, str] | None = None
    infos: dict[str, str] = field(default_factory=dict)
    rectified: bool = False
    cameras: CameraRig | None = None
    wheels: dict[Side, WheelSource] | None = None
    head: Head | None = None
    joints: tuple[str, ...] | None = None
    elsewhere: Mapping[str, JointField | JointTransform] = field(default_factory=dict)
    shared: Mapping[str, tuple[str, ...]] = field(default_factory=dict)
    notes: tuple[str, ...] = ()
    lacks: list[tuple[Part, _Lack]] = field(default_factory=list)

    @property
    def wheel_joints(self) -> set[str]:
        """Joints of the wheels, except those on a configured topic."""
        stated = self.config.wheels.of_sides
        free = [
            w for side, w in (self.wheels or {}).items() if not (stated[side].topic or stated[side].topics)
        ]
        return {wheel.joint for each in free for wheel in each.every if wheel.joint}


def complete_rig(survey: Survey) -> Rig:
    """The rig of a survey.

    Raises:
        RecordingError: the recording lacks something that the configuration does not give.
        ConfigError: configuration and recording contradict each other, or several choices remain.
    """
    config, images, cameras, wheels = survey.config, survey.images, survey.cameras, survey.wheels
    head, joints = survey.head, survey.joints
    if survey.lacks or not (images and cameras and wheels and head) or joints is None:
        raise survey.lacks[0][1]
    infos, chain, drawn = survey.infos, head.chain, head.drawn
    sources = Sources(images, infos, joints, wheels, survey.elsewhere, config.cameras.layout)
    assumed = sources.assumed_wheels
    nominal = Nominal(wheels=assumed).over(config.nominal.stated).over(drawn)

    # What each setting is, its key in rig.yaml, and its source if neither a flag nor the file gives it.
    rows = [
        ("board size", "board.columns", "images"),
        ("board square_m", "board.square_m", "stereo"),
        *((f"{name} images {topic}", f"cameras.{name}.image", "log") for name, topic in images.items()),
        *(
            (f"{camera_words(name)} info {topic}", f"cameras.{name}.info", "log")
            for name, topic in infos.items()
        ),
        (f"images are {'rectified' if survey.rectified else 'raw'}", "cameras.rectified", "topic name"),
    ]
    if len(images) > 1:
        rows.append((f"reference camera {cameras.reference}", "cameras.reference", "default"))
    if chain.joints:
        rows += [
            (f"joint states {', '.join(joints)}", "joints.topic", "log"),
            (f"pan joint {chain.pan or 'none'}", "joints.pan", "joint name"),
            (f"tilt joint {chain.tilt or 'none'}", "joints.tilt", "joint name"),
            (f"head chain {chain.base_frame} to {chain.head_frame}", "", head.origin),
        ]
    else:
        rows.append((f"camera fixed to {chain.base_frame}", "", head.origin))
    rows += [
        (f"{side} wheel {own.topic} {own.where}", f"wheels.{side}", "log") for side, own in wheels.items()
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


def _named_frames(infos: dict[str, CameraInfo], head: Head | None) -> Iterator[str]:
    """A note on each camera whose driver names no frame of its own; what it names is then deleted.

    Raises:
        ConfigError: the head's frame is the one that the outputs would call a camera's.
    """
    for name, info in infos.items():
        own, of_head = info.frame_id, "" if head is None else head.chain.head_frame
        said = f"Neither the images nor the camera info of the {camera_words(name)} name its optical frame."
        if own and own == of_head:
            said = f"The frame_id of the {camera_words(name)} is that of the head, {own}."
        elif own:
            continue
        infos[name] = replace(info, frame_id="")
        named = optical_frame(name, infos[name])
        if named == of_head:
            raise ConfigError(
                f"{of_head} is the frame of the {camera_words(name)}, not of the head",
                "set head.head_frame to the last link that a joint moves (the base link for a camera on the base)",
            )
        yield f"{said} The outputs call its optical frame {named}."


def survey_rig(config: RigConfig, description: RobotDescription) -> Survey:
    """Everything that configuration and recording determine, and all errors, except those that follow from another.

    Raises:
        ConfigError: the URDF that the configuration names cannot be read.
    """
    survey = Survey(config, description)
    lacks_of_head: list[tuple[Part, _Lack]] = []

    def tried(part: Part, step: Callable[[], T], errors: list[tuple[Part, _Lack]] = survey.lacks) -> T | None:
        try:
            return step()
        except (RecordingError, ConfigError) as error:
            errors.append((part, error))
            return None

    urdf_text = read_urdf(config)
    survey.images = tried("cameras", lambda: image_topics(config, description))
    images = survey.images or {}
    configured = (config.joints.topic, config.wheels.left.topic, config.wheels.right.topic)
    of_robot = of_one_robot(description, images.values(), filter(None, configured))
    infos: dict[str, CameraInfo] = {}
    for name, image in images.items():
        topic = tried("camera infos", partial(info_topic, name, image, config, of_robot))
        if topic is not None:
            survey.infos[name], info = topic, of_robot.infos[topic]
            # Some drivers name the optical frame in the images only.
            infos[name] = replace(info, frame_id=info.frame_id or of_robot.image_frames.get(image, ""))
    first = next(iter(images), "")
    survey.rectified = tried("cameras", lambda: are_rectified(images, config.cameras.rectified)) or False
    wheels = tried("wheels", lambda: wheel_sources(config, of_robot))
    reference = config.cameras.reference or first
    frame = infos[reference].frame_id if reference in infos else ""
    head = survey.head = tried(
        "head chain", lambda: head_of(config, of_robot, urdf_text, wheels or {}, frame), lacks_of_head
    )
    survey.notes = tried("head chain", lambda: tuple(_named_frames(infos, head)), lacks_of_head) or ()
    # Which link carries a camera of which nothing is known is no error of its own.
    if images and reference not in infos:
        lacks_of_head = [lack for lack in lacks_of_head if isinstance(lack[1], RecordingError)]
    if images and len(infos) == len(images):
        drawn = partial(fixed_pose, None if head is None else head.urdf)
        survey.cameras = tried("camera infos", lambda: camera_rig(infos, survey.rectified, config, drawn))
    survey.lacks += lacks_of_head
    if wheels is not None and head is not None and head.urdf is not None:
        wheels = as_drawn(wheels, config, head.urdf, head.chain.base_frame)
    survey.wheels = wheels
    if head is not None:
        survey.notes += head.notes
        read = tried("joints", lambda: joint_sources(config, of_robot, head.chain, head.urdf))
        survey.joints, survey.elsewhere = read or (None, {})
        if (cameras := survey.cameras) is not None:
            tried("priors", lambda: prior_sigmas(config.priors, cameras, head.chain))
    of_head = head.chain.joints if head is not None and config.joints.topic is None else ()
    names = survey.wheel_joints | {*of_head} - {*survey.elsewhere}
    on = {
        name: tuple(t for t, names in of_robot.joint_names.items() if name in names) for name in sorted(names)
    }
    survey.shared = {name: topics for name, topics in on.items() if len(topics) > 1}
    return survey
