"""The effective settings, structured as in rig.yaml."""

from __future__ import annotations

import difflib
import math
from collections.abc import Collection, Iterable, Iterator, Mapping, Sequence
from dataclasses import asdict, replace
from typing import Any

import numpy as np

from mobilecal_cli import se3
from mobilecal_cli.errors import ConfigError
from mobilecal_cli.likelihood.constants import KINDS, OF_RECORDINGS, Constant, Kind, table
from mobilecal_cli.model.arrays import FloatArray
from mobilecal_cli.model.observations import Extraction, WheelTrack
from mobilecal_cli.model.rig import (
    SIDES,
    Board,
    CameraRig,
    FixedLink,
    HeadChain,
    JointLink,
    Rig,
    Side,
    WheelSource,
)
from mobilecal_cli.model.signals import Track
from mobilecal_cli.rig.config import PriorEntry, RigConfig, WheelConfig, WheelsNominal, is_in


def _floats(array: FloatArray) -> list[float]:
    return [float(value) + 0.0 for value in array]


def pose_settings(T: FloatArray) -> dict[str, Any]:
    """A pose as rig.yaml states it."""
    return {"translation_m": _floats(T[:3, 3]), "quaternion_xyzw": _floats(se3.quaternion_xyzw(T[:3, :3]))}


def link_settings(link: FixedLink | JointLink) -> dict[str, Any]:
    """A link of the head chain as rig.yaml states it."""
    if isinstance(link, FixedLink):
        T = link.T_parent_child
        return {"xyz_m": _floats(T[:3, 3]), "rpy_rad": _floats(se3.to_rpy(T[:3, :3]))}
    kind = {"kind": link.kind} if link.kind == "prismatic" else {}
    return {"joint": link.joint, "axis": _floats(link.axis), **kind}


def _camera(rig: Rig, name: str) -> dict[str, Any]:
    settings: dict[str, Any] = {"image": rig.sources.image[name], "info": rig.sources.info[name]}
    if not rig.cameras.calibrated and name != rig.cameras.names[0]:
        settings["pose"] = pose_settings(rig.cameras.T_c_each[rig.cameras.names.index(name)])
    return settings


def wheel_settings(source: WheelSource) -> dict[str, Any]:
    """The wheels of a side as rig.yaml states them; of odometry, the wheels that it was made with."""
    names = ("topic", "joint", "field", "ticks_per_revolution", "bits", "sign")
    settings: dict[str, Any] = {name: getattr(source, name) for name in names}
    settings["unread"] = None if source.unread is None else list(source.unread)
    if source.baked_in is not None:
        settings |= {"odometry_separation_share": source.separation_share} if source.assumed else {}
        settings[f"odometry_{'assumed' if source.assumed else 'made'}_with"] = asdict(source.baked_in)
    for name in ("topic", "joint", "field", "sign") if source.others else ():
        values = [getattr(part, name) for part in source.every]
        if name != "topic" or len(set(values)) > 1:
            settings.pop(name)
            settings[f"{name}s"] = None if values[0] is None else values
    return {key: value for key, value in settings.items() if value is not None}


def board_settings(board: Board, measured_m: Sequence[float]) -> dict[str, Any]:
    """A board as rig.yaml states it, with the size of its squares if that was stated or measured."""
    settings: dict[str, Any] = {"columns": board.columns, "rows": board.rows, "square_m": board.square_m}
    if board.square_m is not None:
        settings["square_from"] = "stated"
    elif measured_m:
        settings |= {"square_m": float(np.median(measured_m)), "square_from": "measured by the stereo pair"}
    markers = board.markers
    if markers is not None:
        share = "marker_share" if markers.kind == "charuco" else "gap_share"
        settings |= {"kind": markers.kind, "dictionary": markers.dictionary, share: markers.share}
        settings |= {"first_id": markers.first_id, "border_bits": markers.border_bits}
    return settings


def settings_of(extraction: Extraction) -> dict[str, Any]:
    """Every setting that the result depends on, nested as in rig.yaml, with its source."""
    rig, board = extraction.rig, extraction.board
    elsewhere = {name: f"{source.topic}: {source.where}" for name, source in rig.sources.elsewhere.items()}
    settings: dict[str, Any] = {
        "board": board_settings(board, [o.square_m for o in extraction.observations]),
        "cameras": {
            **{name: _camera(rig, name) for name in rig.cameras.names if rig.sources.image[name]},
            **({} if rig.sources.layout == "separate" else {"layout": rig.sources.layout}),
            "reference": rig.cameras.reference,
            "rectified": rig.cameras.rectified,
        },
        "joints": {
            "topics": rig.sources.joint_topics,
            "pan": rig.chain.pan,
            "tilt": rig.chain.tilt,
            **({"elsewhere": elsewhere} if elsewhere else {}),
        },
        "wheels": {side: wheel_settings(rig.sources.wheels[side]) for side in SIDES},
        "head": {
            "base_frame": rig.chain.base_frame,
            "head_frame": rig.chain.head_frame,
            "chain": [link_settings(link) for link in rig.chain.links],
        },
        "setting_sources": dict(rig.setting_sources),
    }
    nominal = rig.nominal
    if nominal.wheels is not None and rig.sources.assumed_wheels is None:
        sizes = asdict(nominal.wheels)
        settings["nominal"] = {"wheels": {name: sizes[name] for name in WheelsNominal.model_fields}}
    if nominal.T_h_reference is not None:
        settings.setdefault("nominal", {})["head_eye"] = pose_settings(nominal.T_h_reference)
    if rig.noise:
        settings["noise"] = dict(rig.noise)
    if rig.prior_sigmas:
        settings["priors"] = shown_priors(rig.prior_sigmas, rig.cameras, rig.chain)
    return settings


#: Name that stands for all constants.
ALL = "all"


def prior_sigmas(priors: Mapping[str, PriorEntry], cameras: CameraRig, chain: HeadChain) -> dict[str, float]:
    """Name of each constant that the configuration mentions → its prior sigma, see `Rig.prior_sigmas`.

    Kinds stand for the constants of single recordings. An entry for one constant overrides that of its kind, which
    overrides that of all. An entry is one standard deviation in the kind's unit for people, "fixed" or "free".

    Raises:
        ConfigError: a name that this robot does not have.
    """
    rows = table(cameras, chain)
    kinds, names = [kind.name for kind in KINDS], [row.name for row in rows]
    known = [ALL, *kinds, *names]
    for name in priors:
        if name not in known:
            near = difflib.get_close_matches(name, known, 1)
            every = f"kinds: {', '.join(kinds)}; constants: {', '.join(names)}"
            hint = f"did you mean {near[0]}?" if near else every
            raise ConfigError(f"priors.{name}: this robot has no such constant", hint)
    sigmas = {}
    for name, kind_of, factor in _units(rows):
        entry = next((priors[key] for key in (name, kind_of.name, ALL) if key in priors), None)
        if isinstance(entry, str):
            sigmas[name] = {"fixed": 0.0, "free": math.inf}[entry]
        elif entry is not None:
            sigmas[name] = entry * factor
    return sigmas


def _units(rows: Iterable[Constant]) -> Iterator[tuple[str, Kind, float]]:
    """Name, kind and how many of its unit one of the unit for people is: of constants, and of kinds of recordings."""
    for row in rows:  # joints that slide have other units than those that turn
        yield row.name, row.of_kind, row.sigma / row.of_kind.sigma / row.of_kind.shown
    yield from ((kind.name, kind, 1 / kind.shown) for kind in KINDS if kind.name in OF_RECORDINGS)


def shown_priors(sigmas: Mapping[str, float], cameras: CameraRig, chain: HeadChain) -> dict[str, PriorEntry]:
    """The inverse of `prior_sigmas`: name → standard deviation in the kind's unit for people, "fixed" or "free"."""
    words: dict[float, PriorEntry] = {0.0: "fixed", math.inf: "free"}
    entries: dict[str, PriorEntry] = {}
    for name, _, factor in _units(table(cameras, chain)):
        if (sigma := sigmas.get(name)) is not None:
            entries[name] = words.get(sigma, float(f"{sigma / factor:.12g}"))
    return entries


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
    """Refuse those of the dotted keys that were used to make an extraction, which the message names.

    Raises:
        ConfigError: naming them, and the settings that can be changed.
    """
    used = [key for key in keys if not any(is_in(key, name) for name in CHANGEABLE)]
    if used:
        raise ConfigError(
            f"{extraction}: {', '.join(sorted(used))} cannot be changed in an extraction: the images and readings "
            "were read with the old value",
            f"calibrate from the recording; these settings can be changed: {', '.join(CHANGEABLE)}",
        )


def with_settings(extraction: Extraction, config: RigConfig) -> Extraction:
    """The extraction with the settings that flags gave in place of its own.

    Raises:
        ConfigError: a setting that this robot does not have.
    """
    rig, given = extraction.rig, config.flags
    sigmas = prior_sigmas(config.priors, rig.cameras, rig.chain)
    levels = config.noise.model_dump(exclude_none=True)
    rig = replace(rig, prior_sigmas={**rig.prior_sigmas, **sigmas}, noise={**rig.noise, **levels})
    if config.cameras.reference is not None and "cameras.reference" in given:
        rig = _seen_from(rig, config.cameras.reference)
    if any(is_in(key, "nominal") for key in given):
        rig = _with_nominal(rig, config)
    tracks = extraction.wheels
    for side in SIDES:
        keys = {key for key in given if is_in(key, f"wheels.{side}")}
        if keys:
            rig, tracks = _rescaled(rig, tracks, side, config.wheels.of_sides[side], keys)
    return replace(extraction, rig=rig, wheels=tracks)


def _seen_from(rig: Rig, reference: str) -> Rig:
    """The rig with another reference camera; the nominal head-eye transform is converted."""
    if reference not in rig.cameras.names:
        raise ConfigError(
            f"cameras.reference: {reference!r} is not one of the cameras", ", ".join(rig.cameras.names)
        )
    cameras, nominal = replace(rig.cameras, reference=reference), rig.nominal
    if nominal.T_h_reference is not None:
        T_h_c = nominal.T_h_reference @ se3.inverse(rig.cameras.T_c_reference)
        nominal = replace(nominal, T_h_reference=T_h_c @ cameras.T_c_reference)
    before, now = (f"reference camera {side}" for side in (rig.cameras.reference, reference))
    sources = {now if key == before else key: value for key, value in rig.setting_sources.items()}
    return replace(rig, cameras=cameras, nominal=nominal, setting_sources={**sources, now: "flag"})


def _with_nominal(rig: Rig, config: RigConfig) -> Rig:
    """The rig with the nominal values that the configuration gives."""
    given = config.nominal.stated
    if given.wheels is not None and any(source.baked_in for source in rig.sources.wheels.values()):
        raise ConfigError(
            "nominal.wheels cannot be changed in an extraction whose wheel rotations come from odometry",
            "calibrate from the recording, with the wheels of the robot's driver",
        )
    sources = dict(rig.setting_sources)
    sources |= {} if given.wheels is None else {"nominal wheels": "flag"}
    sources |= {} if given.T_h_reference is None else {"nominal head_eye": "flag"}
    return replace(rig, nominal=given.over(rig.nominal), setting_sources=sources)


def _rescaled(
    rig: Rig, tracks: tuple[WheelTrack, ...], side: Side, wheel: WheelConfig, keys: Collection[str]
) -> tuple[Rig, tuple[WheelTrack, ...]]:
    """The rig and the wheel tracks with another sign or resolution of one wheel."""
    old = rig.sources.wheels[side]
    if old.baked_in is not None:
        raise ConfigError(
            f"{', '.join(sorted(keys))}: the rotation of the wheel was computed from odometry",
            "calibrate from the recording",
        )
    names = {key.rsplit(".", 1)[1] for key in keys}
    new = replace(old, **{name: getattr(wheel, name) for name in names})
    # Turns per unit of the readings, with the sign.
    after, before = (source.sign / (source.ticks_per_revolution or 2 * math.pi) for source in (new, old))
    scaled = []
    for track in tracks:
        own: Track = getattr(track, side)
        scaled.append(replace(track, **{side: replace(own, value=own.value * (after / before))}))
    name = f"{side} wheel {old.topic} {old.where}"
    sources = replace(rig.sources, wheels={**rig.sources.wheels, side: new})
    return replace(rig, sources=sources, setting_sources={**rig.setting_sources, name: "flag"}), tuple(scaled)
