"""Topics of the stereo pair, and its geometry from camera_info."""

from __future__ import annotations

import numpy as np

from mobilecal_cli import se3
from mobilecal_cli.errors import ConfigError, RecordingError
from mobilecal_cli.model import (
    IMAGES,
    SIDES,
    Camera,
    CameraInfo,
    FloatArray,
    RobotDescription,
    Side,
    StereoRig,
    listed,
)
from mobilecal_cli.ranges import Range
from mobilecal_cli.rig.config import RigConfig
from mobilecal_cli.rig.names import mirrored, pairs, side_of, words

#: Distance between the cameras of a stereo pair.
BASELINE = Range(1e-4, 5.0, "m")
#: Relative difference of the focal lengths of both rectified images, which are the same.
_SAME_FOCAL = 0.01
#: Words in the name of an image topic that name the form of the images, not the camera.
_FORMS = {
    "image", "raw", "color", "colour", "mono", "gray", "grey", "compressed", "video", "ffmpeg", "h264", "h265",
    "theora",
}  # fmt: skip


def _present(description: RobotDescription) -> str:
    return listed(f"{topic.name} ({topic.type})" for topic in description.topics)


def is_rectified(topic: str) -> bool:
    """Whether the name of an image topic indicates rectified images."""
    return any(word.startswith("rect") for word in words(topic))


def image_topics(config: RigConfig, description: RobotDescription) -> dict[Side, str]:
    """Image topics of both sides: as configured, or a pair whose names differ only in the side.

    Raw images are preferred to rectified ones (the reprojection error is then in raw pixels), and full messages to
    compressed ones.

    Raises:
        RecordingError: no such pair; the hint lists the topics present.
        ConfigError: several stereo cameras.
    """
    present = {topic.name: topic for topic in description.topics if topic.type in IMAGES}
    configured: dict[Side, str | None] = {side: getattr(config.cameras, side).image for side in SIDES}
    for side, name in configured.items():
        if name is not None and name not in present:
            raise RecordingError(
                f"cameras.{side}.image: the topic {name} contains no images in this recording",
                f"image topics present: {listed(sorted(present))}; all topics: {_present(description)}",
            )
    if not present:
        raise RecordingError(
            "no image topics were recorded",
            "record the images of both cameras (sensor_msgs/Image or CompressedImage) with the joint states; "
            f"topics present: {_present(description)}",
        )
    candidates = [
        pair for pair in pairs(present) if all(configured[side] in (None, pair[side]) for side in SIDES)
    ]
    if config.cameras.both is not None:
        both = config.cameras.both.image
        if both not in present:
            raise RecordingError(
                f"cameras.both.image: the topic {both} contains no images in this recording",
                f"image topics present: {listed(sorted(present))}",
            )
        return {"left": both, "right": both}
    if configured["left"] and configured["right"]:
        if configured["left"] == configured["right"]:
            raise ConfigError(
                f"cameras.left.image and cameras.right.image are both {configured['left']}",
                "set them to different topics; for both cameras in one image, set cameras.both.image",
            )
        return {"left": configured["left"], "right": configured["right"]}
    if config.cameras.rectified is not None:
        fitting = [pair for pair in candidates if is_rectified(pair["left"]) == config.cameras.rectified]
        candidates = fitting or candidates
    if not candidates:
        raise RecordingError(
            "no stereo pair: no two image topics have names that differ only in left and right",
            f"set cameras.left.image and cameras.right.image; topics present: {_present(description)}",
        )

    cameras: dict[tuple[str, ...], dict[Side, str]] = {}  # pairs that differ only in the form of their images
    for pair in candidates:
        camera_words = (w for w in mirrored(pair["left"]) if w not in _FORMS and not w.startswith("rect"))
        cameras.setdefault(tuple(camera_words), pair)
    if len(cameras) > 1 and configured["left"] is None and configured["right"] is None:
        several = "; ".join(f"{pair['left']} and {pair['right']}" for pair in cameras.values())
        raise ConfigError(
            f"several pairs of image topics could be the stereo pair: {several}",
            "set cameras.left.image and cameras.right.image in rig.yaml",
        )

    def preference(pair: dict[Side, str]) -> tuple[bool, bool, str]:
        return is_rectified(pair["left"]), "CompressedImage" in present[pair["left"]].type, pair["left"]

    return min(candidates, key=preference)


def info_topic(side: Side, image: str, config: RigConfig, description: RobotDescription) -> str:
    """Camera-info topic of an image topic: as configured, in the same namespace, or with the same frame.

    Raises:
        RecordingError: no topic matches, or its calibration cannot be used.
    """
    topic = _info_topic(side, image, config, description)
    if topic in description.unusable:
        raise description.unusable[topic]
    return topic


def _info_topic(side: Side, image: str, config: RigConfig, description: RobotDescription) -> str:
    present = {*description.infos, *description.unusable}
    configured: str | None = getattr(config.cameras, side).info
    if configured is not None:
        if configured not in present:
            raise RecordingError(
                f"cameras.{side}.info: the topic {configured} contains no camera info in this recording",
                f"camera-info topics present: {listed(sorted(present))}",
            )
        return configured
    namespace = image.removesuffix("/compressed").rsplit("/", 1)[0]
    beside = f"{namespace}/camera_info"
    both = config.cameras.both is not None
    if beside in present and not both:
        return beside
    frame = "" if both else description.image_frames.get(image, "")
    same_frame = sorted(name for name, info in description.infos.items() if frame and info.frame_id == frame)
    same_side = sorted(name for name in present if side_of(name) == side)
    for topics in (same_frame, same_side):
        if len(topics) == 1:
            return topics[0]
    raise RecordingError(
        f"no camera info for the {side} images on {image}: expected "
        + (f"one topic named {side}" if both else beside),
        f"set cameras.{side}.info; camera-info topics present: {listed(sorted(present))}",
    )


def _camera(info: CameraInfo, rectified: bool) -> Camera:
    if rectified:
        return Camera(info.frame_id, info.width, info.height, info.P[:, :3], np.zeros(0), "none")
    return Camera(info.frame_id, info.width, info.height, info.K, info.D, info.distortion)


def stereo_rig(left: CameraInfo, right: CameraInfo, rectified: bool, reference: Side = "left") -> StereoRig:
    """Geometry of the stereo pair from its two camera infos, by ROS conventions.

    Raw coordinates x of a camera become rectified coordinates R x. The rectified frames are parallel, and
    P = (K', K' t) gives the pair's origin in each. Hence T_c_r = (R_c^T R_r, R_c^T (t_r' - t_c')). If the images are
    rectified, c and r are the rectified frames.

    Raises:
        RecordingError: no baseline, or left and right are exchanged.
    """
    # Origin of the pair's rectified frame in each camera's rectified coordinates, (3,), m.
    origin, other_origin = (np.linalg.solve(info.P[:, :3], info.P[:, 3]) for info in (left, right))
    offset = origin - other_origin
    if abs(left.P[0, 0] / right.P[0, 0] - 1) > _SAME_FOCAL:
        raise RecordingError(
            f"P[0, 0] is {left.P[0, 0]:g} in {left.frame_id or 'left'} and {right.P[0, 0]:g} in "
            f"{right.frame_id or 'right'}: these are not the camera infos of one stereo pair",
            "calibrate both cameras together, as a stereo pair",
        )
    if np.linalg.norm(offset) < BASELINE.low:
        raise RecordingError(
            f"the stereo pair has no baseline: P[0, 3] is {left.P[0, 3]:g} in {left.frame_id or 'left'} and "
            f"{right.P[0, 3]:g} in {right.frame_id or 'right'}",
            "calibrate the stereo pair; the right camera's P[0, 3] must be -fx * baseline",
        )
    if offset[0] < 0:
        raise RecordingError(
            f"the right camera is {-offset[0] * 1e3:.1f} mm to the left of the left camera, according to camera_info",
            "exchange cameras.left and cameras.right",
        )
    check_baseline(offset)
    R_rect_c, R_rect_r = (np.eye(3), np.eye(3)) if rectified else (left.R, right.R)
    T_c_r = se3.transform(R_rect_c.T @ R_rect_r, R_rect_c.T @ offset)
    return StereoRig(
        _camera(left, rectified), _camera(right, rectified), T_c_r, rectified, left.R, right.R, reference
    )


def check_baseline(offset_m: FloatArray) -> None:
    """Check that the distance between the cameras, (3,), is possible.

    Raises:
        RecordingError: it is not.
    """
    baseline_m = float(np.linalg.norm(offset_m))
    if baseline_m not in BASELINE:
        raise RecordingError(
            f"the stereo baseline in camera_info is {baseline_m:g} m (range {BASELINE})",
            "calibrate the stereo pair with a board whose squares are stated in meters: P[0, 3] is -fx * baseline",
        )


def check_sizes(infos: dict[Side, CameraInfo]) -> None:
    """Raise a ConfigError if a camera info contains no image size."""
    for side, info in infos.items():
        if info.width <= 0 or info.height <= 0:
            raise ConfigError(
                f"camera info of the {side} camera: the image size is {info.width} x {info.height} pixels",
                "calibrate the camera and record its camera_info again",
            )
