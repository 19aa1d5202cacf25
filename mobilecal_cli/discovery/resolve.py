"""Resolve the rig: flags first, then the file, the recording, and defaults."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from functools import partial
from typing import Literal, TypeVar

from mobilecal_cli.config import RigConfig
from mobilecal_cli.discovery.cameras import check_sizes, image_topics, info_topic, is_rectified, stereo_rig
from mobilecal_cli.discovery.chain import (
    chain_from_urdf,
    drawn_head_eye,
    explicit_chain,
    frames,
    nominal_of,
)
from mobilecal_cli.discovery.joints import joint_fields, joint_topics, joint_transforms, pan_and_tilt
from mobilecal_cli.discovery.priors import prior_sigmas
from mobilecal_cli.discovery.transforms import urdf_of_transforms
from mobilecal_cli.discovery.wheels import nominal_wheels, wheel_sources
from mobilecal_cli.errors import ConfigError, RecordingError
from mobilecal_cli.kinematics.urdf import Urdf, parse_urdf
from mobilecal_cli.model import (
    SIDES,
    HeadChain,
    JointField,
    JointLink,
    JointTransform,
    KnownNoise,
    Nominal,
    Rig,
    RobotDescription,
    Side,
    Sources,
    StereoLayout,
    StereoRig,
    WheelSource,
)

T = TypeVar("T")
_Lack = RecordingError | ConfigError
#: Parts of a rig that can be unknown.
Part = Literal["cameras", "camera infos", "wheels", "head chain", "joints", "priors"]


@dataclass(frozen=True, slots=True)
class ResolvedRig:
    """A resolved rig, and notes on it.

    Attributes:
        rig: the complete rig.
        notes: complete sentences for the report.
    """

    rig: Rig
    notes: tuple[str, ...]


def _given(config: RigConfig, flags: frozenset[str], key: str) -> str | None:
    """Source of a dotted key or of a key below it: "flag", "file", or None."""
    if any(flag == key or flag.startswith(f"{key}.") for flag in flags):
        return "flag"
    value: object = config
    for part in key.split("."):
        if part not in getattr(value, "model_fields_set", ()):
            return None
        value = getattr(value, part)
    return "file"


@dataclass(frozen=True, slots=True, eq=False)
class Head:
    """The head chain and its source.

    Attributes:
        chain: base to head.
        urdf: its URDF, None for a chain given in the configuration.
        drawn: nominal values of the URDF.
        origin: source of the chain, in words.
        notes: remarks for the report.
    """

    chain: HeadChain
    urdf: Urdf | None
    drawn: Nominal
    origin: str
    notes: tuple[str, ...]


def _head(
    config: RigConfig,
    description: RobotDescription,
    urdf_text: str | None,
    wheels: dict[Side, WheelSource],
    camera_frame: str,
) -> Head:
    if config.head.chain is not None:
        moving = [link.joint for link in config.head.chain if link.joint]
        pan, tilt = pan_and_tilt(config, description, dict.fromkeys(moving))
        base, head = config.head.base_frame or "base_link", config.head.head_frame or "head_link"
        chain = explicit_chain(config, base, head, pan, tilt)
        return Head(chain, None, Nominal(), "head.chain of the configuration", ())
    origin = "head.urdf of the configuration"
    notes = []
    if urdf_text is None and not description.urdfs:
        return _head_of_transforms(config, description, wheels, camera_frame)
    if urdf_text is None:
        topic, urdf_text = next(iter(sorted(description.urdfs.items())))
        origin = f"URDF on {topic}"
        if len(set(description.urdfs.values())) > 1:
            notes.append(f"The recording contains several URDFs. The one on {topic} is used.")
    urdf = parse_urdf(urdf_text)
    pan, tilt = _pan_and_tilt_of_urdf(config, description, urdf)
    return _mounted(config, urdf, pan, tilt, wheels, camera_frame, origin, notes)


def _head_of_transforms(
    config: RigConfig, description: RobotDescription, wheels: dict[Side, WheelSource], camera_frame: str
) -> Head:
    """The head of a recording without a URDF, from the motion of its transforms."""
    urdf = urdf_of_transforms(description.transforms)
    if camera_frame not in urdf.links:
        to = f"no transforms to the camera frame {camera_frame!r}, " if camera_frame else ""
        raise RecordingError(
            f"the head chain is unknown: no robot_description in the recording, {to}and no head.urdf or head.chain in "
            "the configuration",
            "set head.urdf or head.chain in rig.yaml; mobilecal init LOG --urdf FILE drafts it",
        )
    base = config.head.base_frame or next(
        (name for name in ("base_link", "base_footprint") if name in urdf.links), urdf.root
    )
    moving = [joint.name for joint in urdf.path(base, camera_frame) if joint.kind == "revolute"]
    pan, tilt = pan_and_tilt(config, description, moving)
    if not tilt and moving:  # no frame is named tilt: the last moving joint is the tilt
        tilt, pan = moving[-1], pan or (moving[0] if len(moving) > 1 else "")
    note = (
        "The recording contains no URDF. The head's joints are derived from the motion of its transforms; "
        "joint angles are zero at the first transform."
    )
    return _mounted(config, urdf, pan, tilt, wheels, camera_frame, "transforms in the recording", [note])


def _pan_and_tilt_of_urdf(config: RigConfig, description: RobotDescription, urdf: Urdf) -> tuple[str, str]:
    in_states = {name for names in description.joint_names.values() for name in names} | set(
        config.joints.fields
    )
    pan, tilt = pan_and_tilt(config, description, [name for name in urdf.joints if name in in_states])
    if not tilt and config.head.head_frame is None:
        # Joint states may lack some of the head's joints; the URDF still names them.
        pan, tilt = pan_and_tilt(config, description, list(urdf.joints))
    return pan, tilt


def _mounted(
    config: RigConfig,
    urdf: Urdf,
    pan: str,
    tilt: str,
    wheels: dict[Side, WheelSource],
    camera_frame: str,
    origin: str,
    notes: list[str],
) -> Head:
    chain, chain_notes = chain_from_urdf(config, urdf, wheels, pan, tilt)
    base, _ = frames(config, urdf, tilt)
    drawn = Nominal(drawn_head_eye(urdf, chain.head_frame, camera_frame), nominal_wheels(urdf, wheels, base))
    return Head(chain, urdf, drawn, origin, (*notes, *chain_notes))


def _check_moves(chain: HeadChain) -> None:
    if not any(isinstance(link, JointLink) for link in chain.links):
        raise ConfigError(
            f"no moving joint between {chain.base_frame} and {chain.head_frame}: the camera is fixed to the base",
            "set head.base_frame and head.head_frame to the two ends of the pan-tilt chain",
        )


@dataclass(frozen=True, slots=True, eq=False)
class Survey:
    """The parts of a rig that configuration and recording determine, and why the others are unknown.

    Attributes:
        images, infos: topics of each side.
        rectified: whether the images are rectified.
        cameras: the stereo pair.
        wheels: source of each wheel's rotation.
        head: the head chain.
        elsewhere: the head's joints without joint states.
        joints: JointState topics.
        lacks: (part, error), in order; none if the rig is complete. A part that is unknown only because of an earlier
            error has none of its own.
    """

    images: dict[Side, str] | None
    infos: dict[Side, str]
    rectified: bool
    cameras: StereoRig | None
    wheels: dict[Side, WheelSource] | None
    head: Head | None
    elsewhere: dict[str, JointField | JointTransform]
    joints: tuple[str, ...] | None
    lacks: tuple[tuple[Part, _Lack], ...]


def resolve_rig(
    config: RigConfig,
    description: RobotDescription,
    urdf_text: str | None = None,
    flags: frozenset[str] = frozenset(),
) -> ResolvedRig:
    """Complete a configuration with the contents of the recording.

    Args:
        config: the configuration, flags included.
        `description`: topics and first messages of the recording.
        urdf_text: contents of `head.urdf`, if the configuration names one.
        flags: dotted keys given by flags, for the report.

    Raises:
        RecordingError: the recording lacks something that the configuration does not give.
        ConfigError: configuration and recording contradict each other, or several choices remain.
    """
    return complete_rig(survey_rig(config, description, urdf_text), config, flags)


def complete_rig(survey: Survey, config: RigConfig, flags: frozenset[str] = frozenset()) -> ResolvedRig:
    """The rig of a survey.

    Args:
        survey: of the same configuration.
        config, flags: see `resolve_rig`.

    Raises:
        RecordingError, ConfigError: the first error of the survey.
    """
    images, cameras, wheels, head, joints = (
        survey.images, survey.cameras, survey.wheels, survey.head, survey.joints,
    )  # fmt: skip
    if survey.lacks or not (images and cameras and wheels and head) or joints is None:
        raise survey.lacks[0][1]
    infos, chain, drawn, given = survey.infos, head.chain, head.drawn, nominal_of(config)
    nominal = Nominal(
        drawn.T_h_reference if given.T_h_reference is None else given.T_h_reference,
        given.wheels or drawn.wheels,
    )

    def source_of(key: str, otherwise: str = "log") -> str:
        return _given(config, flags, key) or otherwise

    setting_sources = {
        "board size": source_of("board.columns", "images"),
        "board square_m": source_of("board.square_m", "stereo"),
        f"left images {images['left']}": source_of("cameras.left.image"),
        f"right images {images['right']}": source_of("cameras.right.image"),
        f"left camera info {infos['left']}": source_of("cameras.left.info"),
        f"right camera info {infos['right']}": source_of("cameras.right.info"),
        f"images are {'rectified' if survey.rectified else 'raw'}": source_of(
            "cameras.rectified", "topic name"
        ),
        f"reference camera {config.cameras.reference}": source_of("cameras.reference", "default"),
        f"joint states {', '.join(joints)}": source_of("joints.topic"),
        f"pan joint {chain.pan or 'none'}": source_of("joints.pan", "joint name"),
        f"tilt joint {chain.tilt or 'none'}": source_of("joints.tilt", "joint name"),
        f"head chain {chain.base_frame} to {chain.head_frame}": head.origin,
        **{
            f"{side} wheel {source.topic} {source.joint or source.field}": source_of(f"wheels.{side}")
            for side, source in wheels.items()
        },
        "nominal wheels": source_of("nominal.wheels", "URDF" if drawn.wheels else "none"),
        "nominal head_eye": source_of("nominal.head_eye", "none" if drawn.T_h_reference is None else "URDF"),
    }
    return ResolvedRig(
        Rig(
            cameras,
            chain,
            nominal,
            Sources(images, infos, joints, wheels, survey.elsewhere, stereo_layout(config)),
            setting_sources,
            KnownNoise(**config.noise.model_dump()),
            prior_sigmas(config.priors, cameras, chain),
        ),
        head.notes,
    )


def stereo_layout(config: RigConfig) -> StereoLayout:
    """Arrangement of the two images of a pair."""
    return "separate" if config.cameras.both is None else config.cameras.both.layout


def survey_rig(config: RigConfig, description: RobotDescription, urdf_text: str | None = None) -> Survey:
    """Everything that configuration and recording determine, and all errors, except those that follow from another.

    Args:
        config, `description`, urdf_text: see `resolve_rig`.
    """
    lacks: list[tuple[Part, _Lack]] = []

    def tried(part: Part, step: Callable[[], T]) -> T | None:
        try:
            return step()
        except (RecordingError, ConfigError) as error:
            lacks.append((part, error))
            return None

    reference = config.cameras.reference
    images = tried("cameras", lambda: image_topics(config, description))
    topics: dict[Side, str] = {}
    rectified, cameras = False, None
    if images is not None:
        for side in SIDES:
            topic = tried("camera infos", partial(info_topic, side, images[side], config, description))
            topics |= {side: topic} if topic is not None else {}
        told = config.cameras.rectified
        rectified = is_rectified(images["left"]) if told is None else told
    infos = {side: description.infos[topic] for side, topic in topics.items()}
    if len(infos) == len(SIDES):
        tried("camera infos", lambda: check_sizes(infos))
        cameras = tried(
            "camera infos", lambda: stereo_rig(infos["left"], infos["right"], rectified, reference)
        )
    wheels = tried("wheels", lambda: wheel_sources(config, description))
    frame = infos[reference].frame_id if reference in infos else ""
    head = tried("head chain", lambda: _head(config, description, urdf_text, wheels or {}, frame))
    elsewhere: dict[str, JointField | JointTransform] = {}
    joints: tuple[str, ...] | None = None
    if head is not None:
        tried("head chain", lambda: _check_moves(head.chain))
        elsewhere |= tried("joints", lambda: joint_fields(config, description, head.chain)) or {}
        elsewhere |= joint_transforms(config, description, head.chain, head.urdf)
        joints = tried("joints", lambda: joint_topics(config, description, head.chain, elsewhere))
        if cameras is not None:
            tried("priors", lambda: prior_sigmas(config.priors, cameras, head.chain))
    return Survey(images, topics, rectified, cameras, wheels, head, elsewhere, joints, tuple(lacks))
