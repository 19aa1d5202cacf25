"""The effective settings, structured as in rig.yaml."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import asdict
from typing import Any

import numpy as np

from mobilecal_cli import se3
from mobilecal_cli.discovery import shown_priors
from mobilecal_cli.model import Board, Extraction, FixedLink, FloatArray, HeadChain, WheelSource


def _numbers(array: FloatArray) -> list[float]:
    return [float(value) + 0.0 for value in array]


def _chain(chain: HeadChain) -> list[dict[str, Any]]:
    links: list[dict[str, Any]] = []
    for link in chain.links:
        if isinstance(link, FixedLink):
            links.append(
                {
                    "xyz_m": _numbers(link.T_parent_child[:3, 3]),
                    "rpy_rad": _numbers(se3.to_rpy(link.T_parent_child[:3, :3])),
                }
            )
            continue
        joint: dict[str, Any] = {"joint": link.joint, "axis": _numbers(link.axis)}
        if link.kind == "prismatic":
            joint["kind"] = link.kind
        links.append(joint)
    return links


def _wheel(source: WheelSource) -> dict[str, Any]:
    settings = {
        "topic": source.topic,
        "joint": source.joint,
        "field": source.field,
        "ticks_per_revolution": source.ticks_per_revolution,
        "bits": source.bits,
        "sign": source.sign,
        "odometry_made_with": asdict(source.baked_in) if source.baked_in is not None else None,
    }
    return {key: value for key, value in settings.items() if value is not None}


def _board(board: Board, measured_m: Sequence[float]) -> dict[str, Any]:
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
        "board": _board(board, [o.square_m for o in extraction.observations]),
        "cameras": {
            **{
                side: {"image": rig.sources.image[side], "info": rig.sources.info[side]}
                for side in ("left", "right")
            },
            **({} if rig.sources.layout == "separate" else {"layout": rig.sources.layout}),
            "reference": rig.cameras.reference,
            "rectified": rig.cameras.rectified,
        },
        "joints": {
            "topics": list(rig.sources.joints),
            "pan": rig.chain.pan,
            "tilt": rig.chain.tilt,
            **({"elsewhere": elsewhere} if elsewhere else {}),
        },
        "wheels": {side: _wheel(rig.sources.wheels[side]) for side in ("left", "right")},
        "head": {
            "base_frame": rig.chain.base_frame,
            "head_frame": rig.chain.head_frame,
            "chain": _chain(rig.chain),
        },
        "setting_sources": dict(rig.setting_sources),
    }
    nominal = rig.nominal
    if nominal.wheels is not None:
        wheels = nominal.wheels
        settings["nominal"] = {
            "wheels": {
                "radius_left_m": wheels.radius_left_m,
                "radius_right_m": wheels.radius_right_m,
                "separation_m": wheels.separation_m,
            }
        }
    if nominal.T_h_reference is not None:
        settings.setdefault("nominal", {})["head_eye"] = {
            "translation_m": _numbers(nominal.T_h_reference[:3, 3]),
            "quaternion_xyzw": _numbers(se3.quaternion_xyzw(nominal.T_h_reference[:3, :3])),
        }
    if rig.noise.given:
        settings["noise"] = rig.noise.given
    if rig.prior_sigmas:
        settings["priors"] = shown_priors(rig.prior_sigmas, rig.cameras, rig.chain)
    return settings
