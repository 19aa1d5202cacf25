"""Cameras and head chain of the robot description with the estimated constants applied."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from dataclasses import dataclass, replace

import numpy as np

from mobilecal_cli.camera import project, undistorted
from mobilecal_cli.errors import ConfigError
from mobilecal_cli.kinematics import joint_frames, joint_motion, unlike_joints
from mobilecal_cli.kinematics.urdf import Urdf, chain_links
from mobilecal_cli.likelihood.constants import camera_change, corrected_chain, joint_constants, table
from mobilecal_cli.likelihood.effects import CameraEffect, JointReading
from mobilecal_cli.model.arrays import FloatArray
from mobilecal_cli.model.rig import Camera, CameraRig, HeadChain, Rig

#: Largest acceptable difference between a distortion model and the estimated lens.
_LENS_PX = 0.1
#: Distance of the points of the image at which distortion models are compared, in shares of its width.
_STEP = 1 / 40


@dataclass(frozen=True, slots=True, eq=False)
class ImprovedChain:
    """A head chain, and what the estimated constants change in it.

    Attributes:
        stated: as in the robot description.
        improved: with the estimated axes and positions of the joints.
        zeros: joint → its estimated zero offset, rad or m, to be added to its reading.
        others: estimated scale and backlash of the joints, which are not part of a chain, as text.
    """

    stated: HeadChain
    improved: HeadChain
    zeros: Mapping[str, float]
    others: tuple[str, ...]


def camera_constants(rig: Rig, constants: Mapping[str, float]) -> dict[str, float]:
    """Those of the constants that change the cameras, and are not zero."""
    names = {row.name for row in table(rig.cameras, rig.chain) if isinstance(row.effect, CameraEffect)}
    return {name: value for name, value in constants.items() if name in names and value}


def improved_cameras(
    rig: Rig, constants: Mapping[str, float], kalibr: bool = False
) -> tuple[CameraRig, tuple[str, ...]]:
    """The cameras with the estimated constants; their lens corrections are part of the distortion models.

    Args:
        rig: the robot as stated.
        constants: name → difference from the stated value.
        kalibr: without the third radial coefficient of plumb_bob, which Kalibr does not have.

    Returns:
        The cameras, and sentences on them: whether they are estimated, and how well the models describe the lenses.
    """
    cameras = camera_change(rig.cameras, table(rig.cameras, rig.chain), constants).apply(rig.cameras)
    plain, off = zip(*(without_correction(camera, kalibr) for camera in cameras.each), strict=True)
    cameras = replace(cameras, each=plain)
    what = "stereo pair is" if cameras.calibrated else "cameras are" if len(cameras.each) > 1 else "camera is"
    if not camera_constants(rig, constants):
        return cameras, (f"The {what} as stated in the recording.",)
    notes: tuple[str, ...] = (f"The {what} as estimated by the calibration.",)
    if largest := max(float(each.max(initial=0.0)) for each in off):
        usual = max(float(np.sqrt(np.mean(each**2))) for each in off)
        note = f"The distortion model differs from the estimated lens by {usual:.2g} px rms and at most"
        note += f" {largest:.2g} px"
        limit = f" (limit {_LENS_PX:g} px). To describe the lens better, calibrate the camera with a richer model."
        notes += (f"{note}." if largest <= _LENS_PX else f"{note}{limit}",)
    return cameras, notes


def without_correction(camera: Camera, kalibr: bool = False) -> tuple[Camera, FloatArray]:
    """A camera whose lens correction is part of its distortion model: K stays, D fits best over the image.

    Args:
        camera: with or without a correction.
        kalibr: see `improved_cameras`.

    Returns:
        The camera, and the distances (n,) of its pixels from those of the given one, regularly over the image, px.
    """
    if camera.correction is None:
        return camera, np.zeros(1)
    from scipy.optimize import least_squares  # slow to import; only corrected lenses need it

    plain = replace(camera, correction=None)
    if camera.distortion == "none":
        plain = replace(plain, distortion="plumb_bob", D=np.zeros(5))
    count = int(np.ceil(1 / _STEP)) + 1
    x, y = np.meshgrid(np.linspace(0, camera.width - 1, count), np.linspace(0, camera.height - 1, count))
    pixels = np.stack([x.ravel(), y.ravel()], axis=1)
    flat, good = undistorted(camera, pixels)  # only the part of the image that the camera model produces
    rays, pixels = np.column_stack([flat[good], np.ones(int(good.sum()))]), pixels[good]
    # Numerator and denominator of the rational model can compensate each other, far beyond the image: one is enough.
    free = 4 if kalibr else min(5, len(plain.D))

    def distorted_by(D: FloatArray) -> Camera:
        return replace(plain, D=np.concatenate([D, plain.D[free:]]))

    def residual(D: FloatArray) -> FloatArray:
        return np.asarray((project(distorted_by(D), rays) - pixels).ravel())

    fitted = least_squares(residual, plain.D[:free], x_scale="jac", xtol=1e-12, ftol=1e-12, gtol=1e-12)
    return distorted_by(fitted.x), np.linalg.norm(residual(fitted.x).reshape(-1, 2), axis=1)


def improved_chain(chain: HeadChain, constants: Mapping[str, float]) -> ImprovedChain:
    """The head chain with the estimated constants.

    Args:
        chain: as stated.
        constants: name → difference from the stated value.
    """
    improved, zeros = corrected_chain(chain, constants)
    others = tuple(
        f"{row.name} {constants[row.name] * row.of_kind.shown:+.3g} {row.of_kind.shown_unit}"
        for row in joint_constants(chain)
        if isinstance(row.effect, JointReading) and row.effect.error != "zero" and constants.get(row.name)
    )
    return ImprovedChain(chain, improved, dict(zip(chain.joints, zeros.tolist(), strict=True)), others)


_HINT = "give the URDF that the calibration read"


def joint_origins(urdf: Urdf, chain: ImprovedChain) -> Iterator[tuple[str, FloatArray, FloatArray]]:
    """New origins and axes of the moving joints between base and head.

    A zero offset turns (or shifts) the origin about the axis, so the joint's readings keep their meaning.

    Yields:
        Name of the joint in the URDF, T_parent_child at its zero (4, 4), m, and axis in its frame, (3,) unit vector.

    Raises:
        ConfigError: the chain of the URDF is not the one that the calibration read.
    """
    stated = chain.stated
    moving = [j for j in urdf.path(stated.base_frame, stated.head_frame) if j.kind != "fixed"]
    drawn = replace(stated, links=chain_links(urdf, stated.base_frame, stated.head_frame))
    own, known = joint_frames(drawn)[0], joint_frames(stated)[0]
    # The first transform may differ: the chain starts between the wheels, by its first link, the URDF at its base link.
    from_base = replace(stated, links=stated.links[1:])
    unlike = {*unlike_joints(drawn, stated)} & {*unlike_joints(drawn, from_base)}
    for number, ((link, _), (other, _)) in enumerate(zip(own, known, strict=False)):
        if number in unlike or (link.multiplier, link.offset) != (other.multiplier, other.offset):
            raise ConfigError(
                f"URDF: joint {moving[number].name!r} is not as in the calibrated robot's chain", _HINT
            )
    if len(own) != len(known):
        raise ConfigError(
            f"URDF: {len(own)} joints from {stated.base_frame!r} to {stated.head_frame!r}, {len(known)} in the "
            "calibrated robot's chain",
            _HINT,
        )
    for joint, (link, _) in zip(moving, joint_frames(chain.improved)[0], strict=True):
        zero = np.array(chain.zeros.get(link.joint, 0.0))
        change = joint_motion(replace(link, offset=0.0), zero)  # the offset is in the URDF's <mimic>
        yield joint.name, joint.T_parent_child @ change, link.axis
