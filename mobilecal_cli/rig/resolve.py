"""Resolve the rig: flags first, then the file, the recording, and defaults."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from functools import partial
from typing import Literal, TypeVar

from mobilecal_cli.errors import ConfigError, RecordingError
from mobilecal_cli.model import (
    CameraRig,
    JointField,
    JointTransform,
    KnownNoise,
    Nominal,
    Rig,
    RobotDescription,
    Side,
    Sources,
    StereoLayout,
    WheelSource,
    camera_words,
)
from mobilecal_cli.rig.cameras import (
    camera_rig,
    check_sizes,
    image_topics,
    info_topic,
    is_rectified,
    note_on_choice,
)
from mobilecal_cli.rig.config import RigConfig
from mobilecal_cli.rig.head import Head, fixed_pose, head_of, joint_fields, joint_topics, joint_transforms
from mobilecal_cli.rig.names import of_one_robot
from mobilecal_cli.rig.settings import nominal_of, prior_sigmas
from mobilecal_cli.rig.wheels import wheel_sources, with_drawn_separation

T = TypeVar("T")
_Lack = RecordingError | ConfigError
#: Parts of a rig that can be unknown.
Part = Literal["cameras", "camera infos", "wheels", "head chain", "joints", "priors"]


@dataclass(frozen=True, slots=True, eq=False)
class Survey:
    """The parts of a rig that configuration and recording determine, and why the others are unknown.

    Attributes:
        images, infos: topics of each camera.
        rectified: whether the images are rectified.
        cameras: the cameras.
        wheels: source of each wheel's rotation.
        head: the head chain.
        elsewhere: the head's joints without joint states.
        joints: JointState topics.
        notes: remarks for the report.
        lacks: (part, error), in order; none if the rig is complete. A part that is unknown only because of an earlier
            error has none of its own.
    """

    images: dict[str, str] | None
    infos: dict[str, str]
    rectified: bool
    cameras: CameraRig | None
    wheels: dict[Side, WheelSource] | None
    head: Head | None
    elsewhere: dict[str, JointField | JointTransform]
    joints: tuple[str, ...] | None
    notes: tuple[str, ...]
    lacks: tuple[tuple[Part, _Lack], ...]


def resolve_rig(
    config: RigConfig,
    description: RobotDescription,
    urdf_text: str | None = None,
) -> tuple[Rig, tuple[str, ...]]:
    """Complete a configuration with the contents of the recording: the rig, and notes for the report.

    Raises:
        RecordingError: the recording lacks something that the configuration does not give.
        ConfigError: configuration and recording contradict each other, or several choices remain.
    """
    return complete_rig(survey_rig(config, description, urdf_text), config)


def complete_rig(survey: Survey, config: RigConfig) -> tuple[Rig, tuple[str, ...]]:
    """The rig of a survey of the same configuration, and notes for the report.

    Raises:
        RecordingError, ConfigError: the first error of the survey.
    """
    images, cameras, wheels = survey.images, survey.cameras, survey.wheels
    head, joints = survey.head, survey.joints
    if survey.lacks or not (images and cameras and wheels and head) or joints is None:
        raise survey.lacks[0][1]
    infos, chain, given = survey.infos, head.chain, nominal_of(config)
    drawn = head.drawn
    sources = Sources(images, infos, joints, wheels, survey.elsewhere, stereo_layout(config))
    assumed = sources.assumed_wheels
    nominal = Nominal(
        drawn.T_h_reference if given.T_h_reference is None else given.T_h_reference,
        assumed or given.wheels or drawn.wheels,
    )

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
    rig = Rig(
        cameras,
        chain,
        nominal,
        sources,
        {what: config.source_of(key) or otherwise for what, key, otherwise in rows},
        KnownNoise(**config.noise.model_dump()),
        prior_sigmas(config.priors, cameras, chain),
    )
    return rig, (*survey.notes, *head.notes)


def stereo_layout(config: RigConfig) -> StereoLayout:
    """Arrangement of the two images of a pair."""
    return "separate" if config.cameras.both is None else config.cameras.both.layout


def survey_rig(config: RigConfig, description: RobotDescription, urdf_text: str | None = None) -> Survey:
    """Everything that configuration and recording determine, and all errors, except those that follow from another."""
    lacks: list[tuple[Part, _Lack]] = []

    def tried(part: Part, step: Callable[[], T]) -> T | None:
        try:
            return step()
        except (RecordingError, ConfigError) as error:
            lacks.append((part, error))
            return None

    images = tried("cameras", lambda: image_topics(config, description))
    configured = (config.joints.topic, config.wheels.left.topic, config.wheels.right.topic)
    description = of_one_robot(description, (images or {}).values(), filter(None, configured))
    topics: dict[str, str] = {}
    rectified, cameras = False, None
    notes: tuple[str, ...] = ()
    if images is not None:
        for name, image in images.items():
            topic = tried("camera infos", partial(info_topic, name, image, config, description))
            topics |= {name: topic} if topic is not None else {}
        told = config.cameras.rectified
        rectified = is_rectified(next(iter(images.values()))) if told is None else told
        notes = note_on_choice(images, config, description)
    infos = {name: description.infos[topic] for name, topic in topics.items()}
    whole = images is not None and len(infos) == len(images)
    if whole:
        tried("camera infos", lambda: check_sizes(infos))
    wheels = tried("wheels", lambda: wheel_sources(config, description))
    reference = config.cameras.reference or next(iter(images or {}), "")
    frame = infos[reference].frame_id if reference in infos else ""
    lacks_of_cameras = len(lacks)
    head = tried("head chain", lambda: head_of(config, description, urdf_text, wheels or {}, frame))
    if images is not None and not frame:  # which link carries a camera without a frame is no error of its own
        lacks[lacks_of_cameras:] = [
            own for own in lacks[lacks_of_cameras:] if isinstance(own[1], RecordingError)
        ]
    if whole:
        urdf = None if head is None else head.urdf
        own, lacks[lacks_of_cameras:] = lacks[lacks_of_cameras:], []
        cameras = tried(
            "camera infos", lambda: camera_rig(infos, rectified, config, partial(fixed_pose, urdf))
        )
        lacks += own
    if wheels is not None and head is not None and head.urdf is not None:
        wheels = with_drawn_separation(wheels, config, head.urdf, head.chain.base_frame)
    elsewhere: dict[str, JointField | JointTransform] = {}
    joints: tuple[str, ...] | None = None
    if head is not None:
        elsewhere |= tried("joints", lambda: joint_fields(config, description, head.chain)) or {}
        elsewhere |= joint_transforms(config, description, head.chain, head.urdf)
        joints = tried("joints", lambda: joint_topics(config, description, head.chain, elsewhere))
        if cameras is not None:
            tried("priors", lambda: prior_sigmas(config.priors, cameras, head.chain))
    return Survey(images, topics, rectified, cameras, wheels, head, elsewhere, joints, notes, tuple(lacks))
