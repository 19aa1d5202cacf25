"""Settings that an extraction can be solved again with: those that no reading or detection depends on."""

from __future__ import annotations

import math
from collections.abc import Collection
from dataclasses import replace

from mobilecal_cli import se3
from mobilecal_cli.config import RigConfig, WheelConfig
from mobilecal_cli.discovery import nominal_of, prior_sigmas
from mobilecal_cli.errors import ConfigError
from mobilecal_cli.model import SIDES, Extraction, Nominal, Rig, Side, Track, WheelSource, WheelTrack

#: Keys of rig.yaml, or the sections above them, that apply to an extraction.
CHANGEABLE = (
    "priors",
    "noise",
    "gates",
    "nominal",
    "cameras.reference",
    *(f"wheels.{side}.{name}" for side in SIDES for name in ("sign", "ticks_per_revolution")),
)


def refuse_others(keys: Collection[str], extraction: str) -> None:
    """Refuse settings that were used to make an extraction.

    Args:
        keys: dotted keys that the user gave.
        extraction: name of the extraction, for the message.

    Raises:
        ConfigError: naming them, and the settings that can be changed.
    """
    used = [key for key in keys if not any(key == name or key.startswith(f"{name}.") for name in CHANGEABLE)]
    if used:
        raise ConfigError(
            f"{extraction}: {', '.join(sorted(used))} cannot be changed in an extraction: the images and readings "
            "were read with the old value",
            f"calibrate from the recording; these settings can be changed: {', '.join(CHANGEABLE)}",
        )


def with_settings(extraction: Extraction, config: RigConfig, given: Collection[str]) -> Extraction:
    """The extraction with settings of the configuration in place of its own.

    Args:
        extraction: as read.
        config: the settings.
        given: dotted keys that the user gave; other settings are those of the extraction.

    Raises:
        ConfigError: a setting that this robot does not have.
    """
    rig = extraction.rig
    sigmas = prior_sigmas(config.priors, rig.cameras, rig.chain)
    levels = config.noise.model_dump(exclude_none=True)
    rig = replace(rig, prior_sigmas={**rig.prior_sigmas, **sigmas}, noise=replace(rig.noise, **levels))
    if "cameras.reference" in given:
        rig = _seen_from(rig, config.cameras.reference)
    if any(key.startswith("nominal") for key in given):
        rig = _with_nominal(rig, config)
    tracks = extraction.wheels
    for side in SIDES:
        keys = {key for key in given if key.startswith(f"wheels.{side}.")}
        if keys:
            rig, tracks = _rescaled(rig, tracks, side, getattr(config.wheels, side), keys)
    return replace(extraction, rig=rig, wheels=tracks)


def _seen_from(rig: Rig, reference: Side) -> Rig:
    """The rig with another reference camera; the nominal head-eye transform is converted."""
    cameras, nominal = replace(rig.cameras, reference=reference), rig.nominal
    if nominal.T_h_reference is not None:
        T_h_c = nominal.T_h_reference @ se3.inverse(rig.cameras.T_c_reference)
        nominal = replace(nominal, T_h_reference=T_h_c @ cameras.T_c_reference)
    before, now = (f"reference camera {side}" for side in (rig.cameras.reference, reference))
    sources = {now if key == before else key: value for key, value in rig.setting_sources.items()}
    return replace(rig, cameras=cameras, nominal=nominal, setting_sources={**sources, now: "flag"})


def _with_nominal(rig: Rig, config: RigConfig) -> Rig:
    """The rig with the nominal values that the configuration gives.

    Raises:
        ConfigError: the wheels' rotations were computed with the nominal wheels.
    """
    given = nominal_of(config)
    if given.wheels is not None and any(source.baked_in for source in rig.sources.wheels.values()):
        raise ConfigError(
            "nominal.wheels cannot be changed in an extraction whose wheel rotations come from odometry",
            "calibrate from the recording, with the wheels of the robot's driver",
        )
    sources = dict(rig.setting_sources)
    sources |= {} if given.wheels is None else {"nominal wheels": "flag"}
    sources |= {} if given.T_h_reference is None else {"nominal head_eye": "flag"}
    head_eye = rig.nominal.T_h_reference if given.T_h_reference is None else given.T_h_reference
    return replace(
        rig, nominal=Nominal(head_eye, given.wheels or rig.nominal.wheels), setting_sources=sources
    )


def _rescaled(
    rig: Rig, tracks: tuple[WheelTrack, ...], side: Side, wheel: WheelConfig, keys: Collection[str]
) -> tuple[Rig, tuple[WheelTrack, ...]]:
    """The rig and the wheel tracks with another sign or resolution of one wheel.

    Raises:
        ConfigError: the rotation of the wheel was computed from odometry.
    """
    old = rig.sources.wheels[side]
    if old.baked_in is not None:
        raise ConfigError(
            f"{', '.join(sorted(keys))}: the rotation of the wheel was computed from odometry",
            "calibrate from the recording",
        )
    new = replace(old, **{key.rsplit(".", 1)[1]: getattr(wheel, key.rsplit(".", 1)[1]) for key in keys})
    factor = _turn_per_unit(new) / _turn_per_unit(old)
    scaled = []
    for track in tracks:
        one: Track = getattr(track, side)
        turned = Track(one.time_ns, one.value * factor)
        scaled.append(WheelTrack(turned, track.left) if side == "right" else WheelTrack(track.right, turned))
    name = f"{side} wheel {old.topic} {old.joint or old.field}"
    sources = replace(rig.sources, wheels={**rig.sources.wheels, side: new})
    return replace(rig, sources=sources, setting_sources={**rig.setting_sources, name: "flag"}), tuple(scaled)


def _turn_per_unit(source: WheelSource) -> float:
    """Turns per unit of the readings, with the sign."""
    return source.sign / (source.ticks_per_revolution or 2 * math.pi)
