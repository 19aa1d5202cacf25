"""Findings of a fit for the report: contradictions, scale check, jumps, constants, outliers; recordings pooled."""

from __future__ import annotations

import math
from dataclasses import replace
from typing import Literal

import numpy as np

from mobilecal_cli import se3
from mobilecal_cli.likelihood import jumps
from mobilecal_cli.likelihood.between import weigh_logs
from mobilecal_cli.likelihood.constants import PATTERNS, kind_of
from mobilecal_cli.likelihood.evidence import evidence
from mobilecal_cli.likelihood.legs import wheels_minus_sensor
from mobilecal_cli.likelihood.measurements import BASE
from mobilecal_cli.likelihood.residual_tests import SMALL_M, SMALL_RAD
from mobilecal_cli.model.arrays import IntArray
from mobilecal_cli.model.findings import (
    CONTRADICTION_SIGMAS,
    MATERIAL_SIGMAS,
    Diagnosis,
    EstimatedConstant,
    Evidence,
    Jump,
    ScaleCheck,
)
from mobilecal_cli.model.observations import Extraction
from mobilecal_cli.model.rig import SIDES, camera_words
from mobilecal_cli.model.signals import Track, pauses
from mobilecal_cli.model.solution import Outlier
from mobilecal_cli.model.text import capitalized
from mobilecal_cli.solvers.fit import LikelihoodFit
from mobilecal_cli.solvers.outliers import longest_stretch, moved_before

_HEADING_SHARE, _HEADING_SIGMAS = 0.005, 5.0  # a scale of headings that is less is none
_FEWEST_SCATTERED = 20  # legs whose scatter is a variance
_SCALE_SHOWN = 0.9  # variance of the ratio over its prior's, below which the data show it
_APART_CHI2 = 16.0  # scales that differ by more than four sigma are inconsistent


def contradictions_of(fit: LikelihoodFit) -> tuple[Evidence, ...]:
    """Stated constants that the data contradict: those with a prior of the user, then times, then the strongest first.

    Images that are taken at other times make all else look wrong, too. Where the data contradict a kind as a whole, but
    leave open which part is wrong, it is the likeliest part.
    """
    strongest = {(e.kind, e.part): e for e in evidence(fit.lin)}
    for whole in evidence(fit.lin, parts=False):
        mine = [e for e in strongest.values() if e.kind == whole.kind]
        worst = max(mine, key=lambda e: e.sigmas)
        if worst.sigmas < whole.sigmas:
            strongest[worst.kind, worst.part] = replace(worst, chi2=whole.chi2, sigmas=whole.sigmas)
    priors = fit.lin.priors
    by_user = {name for name, alike in zip(fit.data.layout.names, priors.alike, strict=True) if not alike}
    ranked = sorted(
        strongest.values(),
        key=lambda e: (by_user.isdisjoint(e.values), kind_of(e.kind).unit not in ("s", "s^2"), -e.sigmas),
    )
    return tuple(e for e in ranked if e.sigmas > CONTRADICTION_SIGMAS)


def scale_of(
    extraction: Extraction, fit: LikelihoodFit, contradictions: tuple[Evidence, ...]
) -> ScaleCheck | None:
    """Consistency of square size and stereo baseline; None if no square size is stated or one of them is exact.

    The board measured with the baseline as stated, over its stated size: what both estimates together say, without
    the priors of the two.
    """
    square_m, layout, priors = extraction.board.square_m, fit.data.layout, fit.lin.priors
    names = ("square_scale", "baseline_scale")
    if square_m is None or not all(name in layout.names for name in names):
        return None
    columns = [layout.names.index(name) for name in names]
    if not np.all(priors.weight[columns] > 0):
        return None
    apart = np.array([1.0, -1.0])  # a larger board looks like a shorter baseline
    mean = float(apart @ priors.mean[columns])
    value = float(apart @ priors.displacement(fit.lin.state)[columns]) - mean
    before, stated = (
        float(apart**2 @ (1 / weight[columns])) for weight in (priors.weight, priors.stated_weight)
    )
    after = float(apart @ fit.lin.covariance[np.ix_(columns, columns)] @ apart)
    share = after / before
    if share > _SCALE_SHOWN:
        return None
    ratio, std = mean + value / (1 - share), np.sqrt(after / (1 - share))
    chi2 = (value / (1 - share)) ** 2 / (stated + after / (1 - share))
    wrong = any(contradiction.kind in ("square_size", "baseline_length") for contradiction in contradictions)
    apart_too_far = wrong or chi2 > _APART_CHI2
    baseline_m = extraction.rig.cameras.baseline_m
    return ScaleCheck(1 + ratio, float(std), square_m, baseline_m or 0.0, apart_too_far)


def jumps_of(extraction: Extraction, fit: LikelihoodFit, jump: jumps.ScoredJump | None) -> tuple[Jump, ...]:
    """Where something moved: the most significant jump, from `Inference.jump`, or else a stretch of outliers.

    One that moves neither the result nor the part by what matters at work is none, however sharp the images are.
    """
    if jump is None:
        stretch = longest_stretch(fit)
        return () if stretch is None else (_unexplained(extraction, fit, stretch),)
    turns, value, cameras = jumps.turning(fit.data, jump), jump.value, fit.data.cameras
    turn, others = float(np.linalg.norm(value[turns])), value[~turns]
    of_pair = cameras.calibrated and jump.part == camera_words(cameras.names[1])
    of_focal = jump.part.startswith(jumps.FOCAL)
    no_move = of_pair or of_focal or jump.part in (jumps.SIZE, jumps.SHAPE)
    move = 0.0 if no_move else float(np.linalg.norm(others))
    share = float(np.abs(value).max()) if of_focal else 0.0
    if jump.part in jumps.WHEELS or jumps.slides(fit.data, jump):
        move = float(value[np.argmax(np.abs(value))])
    if jump.shift_sigmas < MATERIAL_SIGMAS and turns.any() and turn < SMALL_RAD:
        # The direction of a baseline is an angle: its length makes it a displacement.
        baseline_m = float(np.linalg.norm(cameras.T_c_each[1][:3, 3])) if of_pair else 1.0
        if np.linalg.norm(others) * baseline_m < SMALL_M:
            return ()
    o = extraction.observations[jump.station]
    sizes = jump.sigmas, jump.shift_sigmas, turn, move
    return (Jump(jump.part, o.log, jump.station, o.time_ns, (0, 0), *sizes, jump.also, share),)


def _unexplained(extraction: Extraction, fit: LikelihoodFit, stretch: IntArray) -> Jump:
    """The moment at which something moved, for legs that nothing confirms."""
    inliers, first = fit.inliers, moved_before(fit, stretch)
    stations = np.unique(fit.data.legs[stretch])
    rejected = int(np.sum(~inliers.views[stations])), int(np.sum(~inliers.legs[stretch]))
    at = extraction.observations[first]
    return Jump("", at.log, first, at.time_ns, rejected, math.inf, math.inf, 0.0, 0.0)


def wrong_headings(fit: LikelihoodFit) -> Diagnosis | None:
    """A scale of a planar sensor's headings: the directions of its motions tell it from the wheels' separation.

    A step of all free parameters and of the scale from the optimum; its variance is by the scatter over the legs, whose
    noise levels have taken up part of the error.
    """
    lin, used = fit.lin, fit.inliers.legs
    if used.sum() < _FEWEST_SCATTERED:
        return None
    legs, W, shared = lin.legs, lin.leg_weight[used], lin.data.layout.size
    by_end, residual = legs.by_end[used][:, :, BASE], legs.residual[used]
    by_heading = np.zeros_like(residual)
    by_heading[:, 5] = -np.array([each.motion[2] for each in lin.data.motions])[used]
    free = lin.priors.onto_free(np.moveaxis(legs.by_shared[used], 2, 0).reshape(shared, -1))
    J = np.concatenate([np.moveaxis(free.reshape(-1, *residual.shape), 0, 2), by_heading[..., None]], axis=2)
    W = W - W @ by_end @ np.linalg.solve(by_end.mT @ W @ by_end, by_end.mT @ W)
    inverse = np.linalg.pinv((J.mT @ W @ J).sum(axis=0), hermitian=True)
    step = -inverse @ (J.mT @ (W @ residual[..., None])).sum(axis=0)
    pulls = (J.mT @ (W @ (residual[..., None] + J @ step)))[..., 0]
    share, std = float(step[-1, 0]), float(np.linalg.norm(pulls @ inverse[-1]))
    if abs(share) < max(_HEADING_SHARE, _HEADING_SIGMAS * std):
        return None
    return Diagnosis(
        f"the headings of the motions are {100 * abs(share):.1f} ± {100 * std:.1f} % too "
        f"{'large' if share > 0 else 'small'} for their directions",
        "check the scale of the headings, as of a gyro, or of the field of view of the sensor",
    )


def constants_of(fit: LikelihoodFit) -> dict[str, EstimatedConstant]:
    """The constants of the robot description as estimated, by name; patterns of corners mean nothing elsewhere."""
    std = np.sqrt(np.diag(fit.covariance)[9:]).tolist()
    priors = fit.lin.priors
    prior = np.where(priors.fixed, 0.0, priors.scales * priors.factors)[9:].tolist()
    value = fit.lin.state.value
    return {
        row.name: EstimatedConstant(row.name, row.kind, row.part, row.meaning, value(row.name), s, p)
        for row, s, p in zip(fit.data.layout.constants, std, prior, strict=True)
        if row.kind not in PATTERNS
    }


def pool_recordings(fit: LikelihoodFit) -> LikelihoodFit:
    """The fit with the spread between recordings included; unchanged for a single recording, or single legs."""
    lin = fit.lin
    if len(np.unique(lin.data.log)) < 2 or lin.data.motions:
        return fit
    between, step, covariance = weigh_logs(lin)
    if np.any(step):
        lin = lin.after(lin.normal.step(step))
    return replace(fit, lin=lin, between=between, pooled_covariance=covariance)


def _gaps_on(extraction: Extraction, fit: LikelihoodFit, leg: int) -> list[str]:
    """Pauses of the wheels' readings on a leg, in which the base may drive unseen.

    A driver that publishes changes alone pauses at most stations: then only those in which the wheel turned.
    """
    start, end = (extraction.observations[k] for k in fit.data.legs[leg].tolist())
    stations = int(np.sum(fit.data.log == start.log))
    sides: dict[str, list[str]] = {}
    for side in SIDES:
        track: Track = getattr(extraction.wheels[start.log], side)
        silent = np.flatnonzero(pauses(track.time_ns))
        for begin in silent if 2 * len(silent) < stations else track.gaps:
            begin_ns, end_ns = track.time_ns[begin : begin + 2]
            if end_ns > start.time_ns and begin_ns < end.time_ns:
                sides.setdefault(f"a gap of {(end_ns - begin_ns) * 1e-9:.1f} s", []).append(side)
    wheels = {gap: f"the {of[0]} wheel" if len(set(of)) == 1 else "both wheels" for gap, of in sides.items()}
    return [f"{gap} in the readings of {of}" for gap, of in wheels.items()]


def outliers_of(extraction: Extraction, fit: LikelihoodFit) -> tuple[Outlier, ...]:
    """Description of each outlier of a fit, in order of time."""
    observations, inliers, state = extraction.observations, fit.inliers, fit.lin.state
    begin = [int(track.time_ns[0]) for track in extraction.wheels]
    outliers: list[Outlier] = []

    def name(i: int) -> str:
        return extraction.station_name(observations[i].log, observations[i].station)

    def clock(i: int) -> str:
        return f"{(observations[i].time_ns - begin[observations[i].log]) / 1e9:.1f} s"

    def add(
        kind: Literal["corners", "station", "slip", "joint"], stations: tuple[int, ...], text: str
    ) -> None:
        last = observations[stations[-1]]
        outliers.append(Outlier(kind, last.log, stations, last.time_ns, text))

    target, views, sensors = (
        ("target", "pose is", "poses") if fit.data.posed else ("board", "images are", "cameras")
    )
    apart, what = fit.lin.legs.residual[:, :3], f"Wheel slip or moved {target}"
    if extraction.motions:
        apart, what, sensors = (
            wheels_minus_sensor(state, fit.lin.legs),
            "Wheel slip, or a wrong motion,",
            "the sensor",
        )
    for leg in np.flatnonzero(~inliers.legs).tolist():
        i, j = fit.data.legs[leg].tolist()
        x, y, psi = apart[leg]
        by = f"{math.hypot(x, y) * 1e3:.0f} mm and {abs(math.degrees(psi)):.1f} degrees"
        last = j + 1 == len(fit.data.log) or fit.data.log[j + 1] != fit.data.log[j]
        after = " A wheel whose size changes on the last leg looks the same." if last else ""
        cause = what
        if gaps := [] if extraction.motions else _gaps_on(extraction, fit, leg):
            cause, after = (
                capitalized(" and ".join(gaps)),
                " Check the driver that publishes them, and its cables.",
            )
        text = (
            f"{cause} between stations {name(i)} and {name(j)}, {clock(j)}: wheels and {sensors} "
            f"differ by {by}. The odometry of this leg is excluded.{after}"
        )
        add("slip", (i, j), text)
    expected, joints, prismatic = state.T_c_k, extraction.rig.chain.joints, extraction.rig.chain.prismatic
    why = f"a moved or wrong {target}{', or wrong joint readings' if joints else ''}"
    for i in np.flatnonzero(~inliers.views).tolist():
        off = se3.log(observations[i].T_c_k @ se3.inverse(expected[i]))
        shift = (observations[i].T_c_k[:3, 3] - expected[i][:3, 3]) * 1e3
        text = (
            f"Station {name(i)}, {clock(i)}: the {target} is {np.linalg.norm(shift):.0f} mm and "
            f"{math.degrees(float(np.linalg.norm(off[:3]))):.1f} degrees from the pose that the other stations "
            f"predict. Its {views} excluded. Check for {why}."
        )
        add("station", (i,), text)
    for i, j in np.argwhere(~inliers.readings).tolist():
        error = -state.own[i, j]
        by = f"{error * 1e3:+.1f} mm" if joints[j] in prismatic else f"{math.degrees(error):+.2f} degrees"
        text = f"Station {name(i)}, {clock(i)}: the reading of joint {joints[j]} is wrong by {by}. It is excluded."
        add("joint", (i,), text)
    excluded, names = fit.data.seen & ~inliers.corners, extraction.rig.cameras.names
    for i in np.flatnonzero(excluded.any(axis=(1, 2)) & inliers.views).tolist():
        number = excluded[i].sum(axis=1).tolist()
        counts = f"{number[0]} corners of the {names[0]} image" if len(names) > 1 else f"{number[0]} corners"
        for k, camera in enumerate(names[1:], 1):
            counts += f"{' and' if k == len(names) - 1 else ','} {number[k]} of the {camera} image"
        add(
            "corners", (i,), f"Station {name(i)}, {clock(i)}: {counts} do not fit the board and are excluded."
        )
    return tuple(sorted(outliers, key=lambda o: (o.log, o.time_ns)))
