"""Topics of the cameras, and their geometry from camera_info, configuration or URDF."""

from __future__ import annotations

import itertools
from collections.abc import Callable, Iterable, Mapping

import numpy as np

from mobilecal_cli import se3
from mobilecal_cli.errors import ConfigError, RecordingError
from mobilecal_cli.model.arrays import FloatArray
from mobilecal_cli.model.rig import SIDES, Camera, CameraInfo, CameraRig, Side, camera_words
from mobilecal_cli.model.signals import IMAGES, RobotDescription, TopicInfo
from mobilecal_cli.model.text import listed
from mobilecal_cli.ranges import Range
from mobilecal_cli.rig.config import CAMERA_NAME, RigConfig
from mobilecal_cli.rig.names import (
    COMPRESSION_WORDS,
    mirrored,
    pairs,
    require_topic,
    side_of,
    words,
)

#: Distance between the cameras of a stereo pair.
BASELINE = Range(1e-4, 5.0, "m")
#: Relative difference of the focal lengths of both rectified images, which are the same.
_SAME_FOCAL = 0.01
#: Words in the name of an image topic that name the form of the images, not the camera.
_FORMS = {"image", "raw", "color", "colour", "mono", "gray", "grey", *COMPRESSION_WORDS}


def _image_topics(description: RobotDescription) -> dict[str, TopicInfo]:
    """Image topics by name: those with messages. Recorders also list topics on which nothing was published."""
    topics = {topic.name: topic for topic in description.topics if topic.type in IMAGES}
    return {name: topic for name, topic in topics.items() if topic.count != 0} or topics


def are_rectified(images: Mapping[str, str], stated: bool | None) -> bool:
    """Whether images are rectified, camera → topic: as the names of their topics say, unless it is stated.

    Raises:
        ConfigError: some are, and some are not.
    """
    if stated is not None:
        return stated
    rectified = [topic for topic in images.values() if is_rectified(topic)]
    raw = [topic for topic in images.values() if topic not in rectified]
    if raw and rectified:
        raise ConfigError(
            f"by their names, the images on {raw[0]} are raw, and those on {rectified[0]} are rectified",
            "give topics of one kind for all cameras, or state cameras.rectified in rig.yaml",
        )
    return bool(rectified)


def is_rectified(topic: str) -> bool:
    """Whether the name of an image topic indicates rectified images."""
    return any(word.startswith("rect") for word in words(topic))


#: Cameras that this tool serves, for refusals.
_SERVED = "a stereo pair, a single camera (of an RGB-D camera, the color camera), or several named cameras"


def image_topics(config: RigConfig, description: RobotDescription) -> dict[str, str]:
    """Image topic of each camera: as configured, a stereo pair whose names differ only in the side, or one camera.

    Raw images are preferred to rectified ones (the reprojection error is then in raw pixels), and full messages to
    compressed ones. A full message on one side and a compressed one on the other is the last choice. The color camera
    of an RGB-D camera is preferred to its pair of infrared cameras if the size of the squares is stated, which a single
    camera needs.

    Raises:
        RecordingError: no such camera; the hint lists the topics present.
        ConfigError: several cameras could be meant.
    """
    present = _image_topics(description)
    recorded = listed(f"{topic.name} ({topic.type})" for topic in description.topics)
    cameras = config.cameras
    if cameras.both is not None:
        require_topic("cameras.both.image", cameras.both.image, present, "images")
        return dict.fromkeys(SIDES, cameras.both.image)
    chosen = {name: topics.image for name, topics in cameras.each.items() if topics.image is not None}
    for name, topic in chosen.items():
        require_topic(f"cameras.{name}.image", topic, present, "images")
    if not present:
        raise RecordingError(
            "no image topics were recorded",
            "record the images of the cameras (sensor_msgs/Image or CompressedImage) with the wheels and the head's "
            f"joints; topics present: {recorded}",
        )
    if len(chosen) == len(cameras.each):
        for first, other in itertools.combinations(chosen, 2):
            if chosen[first] == chosen[other]:
                raise ConfigError(
                    f"cameras.{first}.image and cameras.{other}.image are both {chosen[first]}",
                    "set them to different topics; for both cameras in one image, set cameras.both.image",
                )
        return chosen
    pair = _pair(config, description, present, chosen)
    single = None if chosen else _single(description, cameras.rectified, acceptable=pair is not None)
    if pair is not None:
        of_rgbd = single is not None and _COLOR & {*words(single)} and _INFRARED & {*words(pair["left"])}
        if config.board.square_m is None or not of_rgbd:
            return {side: pair[side] for side in SIDES}
    if single is not None:
        if config.board.square_m is None:
            _check_other_side(single, description)
        return {SINGLE: single}
    raise RecordingError(
        "no camera: no two image topics have names that differ only in left and right, and there is not one "
        f"single camera; this tool serves {_SERVED}",
        f"set cameras.left.image and cameras.right.image, or cameras.{SINGLE}.image for one camera; "
        f"topics present: {recorded}",
    )


def _check_other_side(image: str, description: RobotDescription) -> None:
    """Refuse one camera of a stereo pair whose other camera has topics, and no images."""
    namespace = image.removesuffix("/compressed").rpartition("/")[0]
    for topic in description.topics:
        other, _, name = topic.name.removesuffix("/compressed").rpartition("/")
        of_camera = name == "camera_info" or topic.type in IMAGES
        if of_camera and other != namespace and mirrored(other) == mirrored(namespace):
            lacking = f"{other}{image.removeprefix(namespace)}"
            raise RecordingError(
                f"the stereo pair has images of one camera only: this recording has none on {lacking}",
                f"record {lacking} too; to use {image} alone, state board.square_m",
            )


#: Name of a camera that was found alone.
SINGLE = "camera"
_DEPTH = {"depth", "disparity", "points", "confidence", "mask", "thermal", "aligned"}
_INFRARED = {"infra", "infra1", "infra2", "ir", "infrared"}
_COLOR = {"color", "colour", "rgb"}


def _camera_of(topic_words: Iterable[str]) -> tuple[str, ...]:
    """Words in a topic's name that name the camera, not the form of its images."""
    return tuple(word for word in topic_words if word not in _FORMS and not word.startswith("rect"))


def _preferred(topics: Iterable[str], present: Mapping[str, TopicInfo]) -> str:
    """Of one camera's topics: raw rather than rectified images, full messages rather than compressed ones."""
    return min(topics, key=lambda name: (is_rectified(name), "CompressedImage" in present[name].type, name))


def _pair(
    config: RigConfig,
    description: RobotDescription,
    present: Mapping[str, TopicInfo],
    chosen: Mapping[str, str],
) -> dict[Side, str] | None:
    """Image topics of the stereo pair, None if there is none.

    Without a baseline, left and right beside a third camera are three cameras that look to different sides.

    Raises:
        ConfigError: several stereo cameras.
    """
    possible = pairs(present)
    # A number says less than a side: its camera infos must be those of a pair.
    possible += [
        pair
        for pair in pairs(present, numbered=True)
        if pair not in possible and _has_baseline(pair, config, description)
    ]
    candidates = [
        pair for pair in possible if all(pair[side] == chosen.get(side, pair[side]) for side in SIDES)
    ]
    if config.cameras.rectified is not None:
        fitting = [pair for pair in candidates if is_rectified(pair["left"]) == config.cameras.rectified]
        candidates = fitting or candidates
    alike = [pair for pair in candidates if len({present[topic].type for topic in pair.values()}) == 1]
    candidates = alike or candidates
    if not candidates:
        return None
    described = [
        pair for pair in candidates if all(_described(topic, description) for topic in pair.values())
    ]
    candidates = described or candidates
    cameras: dict[tuple[str, ...], dict[Side, str]] = {}  # pairs that differ only in the form of their images
    for pair in candidates:
        cameras.setdefault(_camera_of(mirrored(pair["left"])), pair)
    if len(cameras) > 1 and not chosen:
        several = "; ".join(f"{pair['left']} and {pair['right']}" for pair in cameras.values())
        raise ConfigError(
            f"several pairs of image topics could be the stereo pair: {several}",
            "set cameras.left.image and cameras.right.image in rig.yaml",
        )
    left = _preferred((pair["left"] for pair in candidates), present)
    pair = next(pair for pair in candidates if pair["left"] == left)
    each = [topics[0] for topics in _each_camera(present, None).values()]
    around = sum(_described(topic, description) for topic in each) > len(SIDES)
    if around and not chosen and config.cameras.right.pose is None:
        alone = all(_described(topic, description) for topic in pair.values())
        return None if alone and not _has_baseline(pair, config, description) else pair
    return pair


def _has_baseline(pair: Mapping[Side, str], config: RigConfig, description: RobotDescription) -> bool:
    try:
        infos = [description.infos[info_topic(side, pair[side], config, description)] for side in SIDES]
        stereo_rig(infos[0], infos[1], rectified=False)
    except (RecordingError, ConfigError, np.linalg.LinAlgError):
        return False
    return True


def _each_camera(topics: Iterable[str], rectified: bool | None) -> dict[tuple[str, ...], list[str]]:
    """Words that name a camera → its image topics; without depth and other images in which no board is found."""
    parts = {name: set(words(name)) for name in topics}
    depth = {
        name for name in parts if parts[name] & _DEPTH or ("stereo" in parts[name] and not side_of(name))
    }
    topics = [name for name in parts if name not in depth]
    if rectified is not None:
        topics = [name for name in topics if is_rectified(name) == rectified] or topics
    # Not `mirrored`: the two cameras of a pair are two cameras.
    cameras: dict[tuple[str, ...], list[str]] = {}
    for name in topics:
        cameras.setdefault(_camera_of(words(name)), []).append(name)
    return cameras


def named_cameras(description: RobotDescription) -> dict[str, str]:
    """Image topic of every camera of a recording, by names for rig.yaml: the words in which their topics differ."""
    present = _image_topics(description)
    cameras = _each_camera(present, None)
    alike = set.intersection(*map(set, cameras)) if len(cameras) > 1 else set()
    named: dict[str, str] = {}
    for own, topics in cameras.items():
        name = "_".join(word for word in own if word not in alike)
        if name in SIDES:
            name = f"{name}_camera"  # left and right are the cameras of a stereo pair
        if not CAMERA_NAME.fullmatch(name) or name in named:
            name = f"camera_{len(named) + 1}"
        named[name] = _preferred(topics, present)
    return named


def _single(description: RobotDescription, rectified: bool | None, acceptable: bool) -> str | None:
    """Image topic of the only camera, or of the only one with a camera info, or of color; None if there is none.

    Topics of one frame with images of several sizes are of one camera: the largest are used.

    Raises:
        ConfigError: several cameras, unless they are acceptable.
    """
    present = _image_topics(description)
    cameras = _each_camera(present, rectified)
    described = {own: names for own, names in cameras.items() if _described(names[0], description)}
    cameras = described or cameras
    color = {own: names for own, names in cameras.items() if any(_COLOR & {*words(name)} for name in names)}
    visible = {own: names for own, names in cameras.items() if _INFRARED.isdisjoint(words(names[0]))}
    for some in (cameras, color, visible):
        if len(some) == 1:
            ((_, names),) = some.items()
            return _preferred(names, present)
    sizes = {_width(names[0], description): names for names in (color or cameras).values()}
    frames = {description.image_frames.get(names[0]) or names[0] for names in sizes.values()}
    if len(frames) == 1 and len(sizes) == len(color or cameras):  # one camera in several sizes
        return _preferred(sizes[max(sizes)], present)
    if len(cameras) > 1 and not acceptable:
        several = "; ".join(sorted(names[0] for names in cameras.values()))
        raise ConfigError(
            f"several cameras could be meant: {several}",
            "for a stereo pair, set cameras.left.image and cameras.right.image in rig.yaml; otherwise name one or "
            "more, the first as the reference, such as cameras: {front: {image: "
            f"{min(names[0] for names in cameras.values())}}}}}",
        )
    return None


def _width(image: str, description: RobotDescription) -> int:
    """Width of the images of a topic by the camera info beside it, px; 0 if it is unknown."""
    beside = _info_beside(image)
    return description.infos[beside].width if beside in description.infos else 0


def _info_beside(image: str) -> str:
    """The usual camera-info topic of an image topic."""
    return f"{image.removesuffix('/compressed').rpartition('/')[0]}/camera_info"


def _described(image: str, description: RobotDescription) -> bool:
    """Whether an image topic has a camera info beside it: those of detectors, which draw on images, have none."""
    return _info_beside(image) in {*description.infos, *description.unusable}


def info_topic(name: str, image: str, config: RigConfig, description: RobotDescription) -> str:
    """Camera-info topic of an image topic: as configured, in the same namespace, or with the same frame.

    Raises:
        RecordingError: no topic matches, or its calibration cannot be used.
    """
    present = sorted({*description.infos, *description.unusable})
    configured = config.cameras.of(name).info
    if configured is not None:
        require_topic(f"cameras.{name}.info", configured, present, "camera info")
    beside = _info_beside(image)
    both = config.cameras.both is not None
    frame = "" if both else description.image_frames.get(image, "")
    choices = (
        [configured] if configured is not None else [],
        [beside] if beside in present and not both else [],
        [topic for topic, info in description.infos.items() if frame and info.frame_id == frame],
        [topic for topic in present if side_of(topic) == name],
    )
    topic = next((topics[0] for topics in choices if len(topics) == 1), None)
    if topic is None:
        raise RecordingError(
            f"no camera info for the {name} images on {image}: expected "
            + (f"one topic named {name}" if both else beside),
            f"set cameras.{name}.info; camera-info topics present: {listed(present)}"
            if present
            else "calibrate the camera (camera_calibration), and record its camera_info with the images",
        )
    if topic in description.unusable:
        raise description.unusable[topic]
    return topic


_BASELINE_ADVICE = (
    "calibrate the stereo pair: the right camera's P[0, 3] must be -fx * baseline; or state cameras.right.pose "
    "(pose of the right camera in the left one) and board.square_m in rig.yaml"
)


def _camera(name: str, info: CameraInfo, rectified: bool) -> Camera:
    if info.width <= 0 or info.height <= 0:
        raise ConfigError(
            f"camera info of the {camera_words(name)}: the image size is {info.width} x {info.height} pixels",
            "calibrate the camera and record its camera_info again",
        )
    if rectified:
        if not info.P.any():
            raise RecordingError(
                f"the images are rectified, but P in the camera info of {info.frame_id!r} is all zeros",
                "use the raw images (cameras.NAME.image in rig.yaml), which need only K and D, or record P",
            )
        return Camera(info.frame_id, info.width, info.height, info.P[:, :3], np.zeros(0), "none")
    return Camera(info.frame_id, info.width, info.height, info.K, info.D, info.distortion)


def stereo_rig(left: CameraInfo, right: CameraInfo, rectified: bool, reference: str = "left") -> CameraRig:
    """Geometry of the stereo pair from its two camera infos, by ROS conventions.

    Raw coordinates x of a camera become rectified coordinates R x. The rectified frames are parallel, and
    P = (K', K' t) gives the pair's origin in each. Hence T_c_r = (R_c^T R_r, R_c^T (t_r' - t_c')). If the images are
    rectified, c and r are the rectified frames.

    Raises:
        RecordingError: no baseline, or left and right are exchanged.
    """
    of_each = {side: info.P for side, info in zip(SIDES, (left, right), strict=True)}
    unknown = [side for side, P in of_each.items() if not P.any()]
    # Origin of the pair's rectified frame in each camera's rectified coordinates, (3,), m.
    origins = [np.zeros(3) if unknown else np.linalg.solve(P[:, :3], P[:, 3]) for P in of_each.values()]
    offset = origins[0] - origins[1]
    baseline_m = float(np.linalg.norm(offset))
    if baseline_m < BASELINE.low:
        what = f"P is all zeros in the camera info of {' and '.join(unknown)}"
        if not unknown:
            what = " and ".join(f"P[0, 3] is {P[0, 3]:g} in {side}" for side, P in of_each.items())
        raise RecordingError(f"the stereo pair has no baseline: {what}", _BASELINE_ADVICE)
    if abs(left.P[0, 0] / right.P[0, 0] - 1) > _SAME_FOCAL:
        what = " and ".join(f"P[0, 0] is {P[0, 0]:g} in {side}" for side, P in of_each.items())
        raise RecordingError(
            f"{what}: these are not the camera infos of one stereo pair",
            "calibrate both cameras together, as a stereo pair",
        )
    if offset[0] < 0:
        raise RecordingError(
            f"the right camera is {-offset[0] * 1e3:.1f} mm to the left of the left camera, according to camera_info",
            "exchange cameras.left and cameras.right in rig.yaml; or, if only the camera infos are exchanged, "
            "cameras.left.info and cameras.right.info",
        )
    if baseline_m not in BASELINE:
        raise RecordingError(
            f"the stereo baseline in camera_info is {baseline_m:g} m (range {BASELINE})",
            "calibrate the stereo pair with a board whose squares are stated in meters: P[0, 3] is -fx * baseline",
        )
    R_rect_c, R_rect_r = (np.eye(3), np.eye(3)) if rectified else (left.R, right.R)
    T_c_r = se3.transform(R_rect_c.T @ R_rect_r, R_rect_c.T @ offset)
    cameras = _camera("left", left, rectified), _camera("right", right, rectified)
    poses, R_rect = np.stack([np.eye(4), T_c_r]), np.stack([left.R, right.R])
    return CameraRig(SIDES, cameras, poses, rectified, R_rect, reference, calibrated=True)


def camera_rig(
    infos: Mapping[str, CameraInfo],
    rectified: bool,
    config: RigConfig,
    drawn: Callable[[str, str], FloatArray | None],
) -> CameraRig:
    """Geometry of the cameras: a stereo pair by its camera infos, others by their configured or drawn poses.

    Args:
        infos: calibration of each camera.
        rectified: whether the images are rectified.
        config: poses, and the reference camera.
        drawn: pose of an optical frame in another, by the URDF or the recording's transforms; None if unknown.

    Raises:
        RecordingError: camera infos or poses that are missing or contradict each other.
        ConfigError: one camera, or several without a calibrated baseline, without the size of the squares.
    """
    names = tuple(infos)
    reference = config.cameras.reference or names[0]
    if reference not in names:
        raise ConfigError(
            f"cameras.reference: {reference!r} is not one of the cameras ({', '.join(names)})", "correct it"
        )
    posed = any(config.cameras.of(name).pose is not None for name in names)
    if names == SIDES and not posed:
        return stereo_rig(infos["left"], infos["right"], rectified, reference)
    if config.board.square_m is None:
        uncalibrated = f"{len(names)} cameras without a calibrated baseline do"
        what = "one camera does" if len(names) == 1 else uncalibrated
        raise ConfigError(
            f"{what} not show the size of the board's squares, which gives the scale; it is not stated",
            "measure ten squares with a ruler and add to rig.yaml: board: {square_m: 0.08} "
            "(or --set board.square_m=0.08); a stereo pair shows it by itself",
        )
    first, poses = infos[names[0]], [np.eye(4)]
    for name in names[1:]:
        pose = config.cameras.of(name).pose
        if pose is not None:
            poses.append(pose.transform)
            continue
        T = drawn(first.frame_id, infos[name].frame_id)
        if T is None:
            raise RecordingError(
                f"the pose of camera {name} ({infos[name].frame_id!r}) in the frame of camera {names[0]} "
                f"({first.frame_id!r}) is unknown: no fixed joints of a URDF or of the transforms connect them",
                f"set cameras.{name}.pose in rig.yaml: {{translation_m: [x, y, z], quaternion_xyzw: [x, y, z, w]}}",
            )
        if rectified:
            T = se3.transform(first.R, np.zeros(3)) @ T @ se3.transform(infos[name].R.T, np.zeros(3))
        poses.append(T)
    rotations = np.stack([info.R for info in infos.values()])
    each = tuple(_camera(name, info, rectified) for name, info in infos.items())
    return CameraRig(names, each, np.stack(poses), rectified, rotations, reference)
