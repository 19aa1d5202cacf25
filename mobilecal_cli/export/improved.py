"""Cameras and head chain of the robot description with the estimated constants applied."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, replace

import numpy as np
from scipy.optimize import least_squares

from mobilecal_cli.camera import project, undistorted
from mobilecal_cli.likelihood.effects import (
    CameraEffect,
    ChainChange,
    ChainEffect,
    JointPlay,
    JointScale,
    JointZero,
)
from mobilecal_cli.likelihood.nuisance import Constant, camera_change, table
from mobilecal_cli.model import Camera, FloatArray, HeadChain, Rig, StereoRig

#: Distance of the points of the image at which distortion models are compared, in shares of its width.
_STEP = 1 / 40


@dataclass(frozen=True, slots=True, eq=False)
class Improved:
    """A stereo pair whose lens corrections are part of its distortion models.

    Attributes:
        cameras: without corrections.
        residual_px, residual_rms_px: largest distance between the pixels with the corrections and with the distortion
            models, over both images; and its root mean square in the worse of them.
    """

    cameras: StereoRig
    residual_px: float
    residual_rms_px: float


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


def improved_cameras(rig: Rig, constants: Mapping[str, float], kalibr: bool = False) -> Improved:
    """The stereo pair with the estimated constants.

    Args:
        rig: the robot as stated.
        constants: name → difference from the stated value.
        kalibr: without the third radial coefficient of plumb_bob, which Kalibr does not have.
    """
    cameras = camera_change(table(rig.cameras, rig.chain), constants).apply(rig.cameras)
    left, off_left = without_correction(cameras.left, kalibr)
    right, off_right = without_correction(cameras.right, kalibr)
    largest = max(float(off.max(initial=0.0)) for off in (off_left, off_right))
    usual = max(float(np.sqrt(np.mean(off**2))) for off in (off_left, off_right))
    return Improved(replace(cameras, left=left, right=right), largest, usual)


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
    plain = replace(camera, correction=None)
    if camera.distortion == "none":
        plain = replace(plain, distortion="plumb_bob", D=np.zeros(5))
    rays, pixels = _image_points(camera)
    # Numerator and denominator of the rational model can compensate each other, far beyond the image: one is enough.
    free = 4 if kalibr else min(5, len(plain.D))

    def distorted_by(D: FloatArray) -> Camera:
        return replace(plain, D=np.concatenate([D, plain.D[free:]]))

    def residual(D: FloatArray) -> FloatArray:
        return np.asarray((project(distorted_by(D), rays) - pixels).ravel())

    found = least_squares(residual, plain.D[:free], x_scale="jac", xtol=1e-12, ftol=1e-12, gtol=1e-12)
    return distorted_by(found.x), np.linalg.norm(residual(found.x).reshape(-1, 2), axis=1)


def _image_points(camera: Camera) -> tuple[FloatArray, FloatArray]:
    """Rays (n, 3) and their pixels (n, 2), regularly over the part of the image that the camera model produces."""
    count = int(np.ceil(1 / _STEP)) + 1
    x, y = np.meshgrid(np.linspace(0, camera.width - 1, count), np.linspace(0, camera.height - 1, count))
    pixels = np.stack([x.ravel(), y.ravel()], axis=1)
    flat, good = undistorted(camera, pixels)
    return np.column_stack([flat[good], np.ones(int(good.sum()))]), pixels[good]


def improved_chain(rig: Rig, constants: Mapping[str, float]) -> ImprovedChain:
    """The head chain with the estimated constants.

    Args:
        rig: the robot as stated.
        constants: name → difference from the stated value.
    """
    change, zeros, others = ChainChange(), dict[str, float](), list[str]()
    for row in table(rig.cameras, rig.chain):
        value, effect = constants.get(row.name, 0.0), row.effect
        if not value:
            continue
        if isinstance(effect, ChainEffect):
            effect.add(change, value)
        elif isinstance(effect, JointZero):
            zeros[rig.chain.joints[effect.joint]] = value
        elif isinstance(effect, JointScale | JointPlay):
            others.append(_shown(row, value))
    return ImprovedChain(rig.chain, change.apply(rig.chain), zeros, tuple(others))


def _shown(row: Constant, value: float) -> str:
    kind = row.of_kind
    return f"{row.name} {value * kind.shown:+.3g} {kind.shown_unit}"
