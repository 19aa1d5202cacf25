"""Effect of the corners on the nine parameters: Monte Carlo on rendered images, cornerSubPix and the corner model."""

from dataclasses import replace
from functools import cache

import numpy as np

from mobilecal_cli import se3
from mobilecal_cli.errors import SolveError
from mobilecal_cli.model.observations import Corners, Extraction
from mobilecal_cli.simulate.render import BoardRenderer
from mobilecal_cli.simulate.robot import PAPER_ROBOT, pixels
from mobilecal_cli.simulate.route import base_in_world
from mobilecal_cli.vision.corner_model import fit_corners, refine_widely
from mobilecal_cli.vision.values import Appearance
from tests.actual import station_times_s
from tests.bench.corners import sub_pix
from tests.bench.pictures import shortest_edge_px
from tests.bench.simulated import JOINT_RAD, WHEEL, route_of
from tests.bench.study import DEGREES_MM, NINE_COLUMNS, numbers, paragraph, results_of, rms, table
from tests.extractions import Noise, extraction_of
from tests.fits import maximum_likelihood
from tests.pairs import measured_anew
from tests.robots import corners_of
from tests.truth import errors, nees

STATIONS, RUNS, RUNS_PER_ROUTE = 12, 40, 10
_GREY, _BLUR_PX, _START_PX = 2.0, 0.6, 0.3
_SHAPE = (6, 9, 2)


@cache
def _pictures(number: int) -> tuple[tuple[np.ndarray, np.ndarray], ...]:
    """Noise-free image and true corners of each station of a route, for both cameras."""
    robot, route = PAPER_ROBOT, route_of(STATIONS, number)
    rig, times_s = robot.rig_cameras, station_times_s(route)
    made = []
    T_w_v = base_in_world(route.drive.poses(times_s))
    for k, camera in enumerate((rig.each[0], rig.each[1])):
        renderer = BoardRenderer(camera, route.board, _BLUR_PX, np.random.default_rng([number, k]))
        for i, joints in enumerate(route.joints(times_s)):
            T_c_k = se3.inverse(T_w_v[i] @ robot.head_pose(joints) @ robot.T_h_c) @ route.T_w_k
            T = T_c_k if k == 0 else se3.inverse(rig.T_c_each[1]) @ T_c_k
            corners = pixels(camera, corners_of(route) @ T[:3, :3].T + T[:3, 3])
            made.append((renderer.picture(T).copy(), corners.reshape(_SHAPE)))
    return tuple(made)


def _found(image: np.ndarray, start: np.ndarray, how: str) -> Corners:
    if how == "cornerSubPix":
        return Corners(sub_pix(image, start).reshape(-1, 2), 0.05, 1)
    fit = fit_corners(image, refine_widely(image, start, shortest_edge_px(start), True), Appearance())
    claimed = float(np.sqrt(np.median(np.trace(fit.cov, axis1=1, axis2=2) / 2)))
    return Corners(fit.pixels, claimed, 1, relative_cov=fit.cov / claimed**2)


def _with_corners(extraction: Extraction, number: int, seed: int, how: str) -> tuple[Extraction, float]:
    """The extraction with corners from noisy images, and their root-mean-square error, px."""
    random, seen, off = np.random.default_rng([seed, 5]), [], []
    pictures, rig = _pictures(number), extraction.rig.cameras
    points_k = extraction.board.grid() * (extraction.board.square_m or 1.0)
    for i, observation in enumerate(extraction.observations):
        both = []
        for picture, truth in (pictures[i], pictures[STATIONS + i]):
            noisy = np.round(picture + _GREY * random.normal(size=picture.shape))
            image = np.clip(noisy, 0, 255).astype(np.uint8)
            both.append(_found(image, truth + _START_PX * random.normal(size=truth.shape), how))
            off.append(both[-1].pixels - truth.reshape(-1, 2))
        measured = measured_anew(rig, observation, points_k, *both)
        assert measured is not None
        seen.append(measured)
    return replace(extraction, observations=tuple(seen)), float(np.sqrt(np.mean(np.square(off))))


def one_run(quiet: bool, seed: int) -> dict[str, tuple[np.ndarray, float, float]]:
    """Error of the nine parameters, NEES / 9 and corner error, by corner method."""
    robot, number = PAPER_ROBOT, seed // RUNS_PER_ROUTE
    # A hundredth of the usual noise of wheels and joints shows the effect of the corners alone.
    share = 0.01 if quiet else 1.0
    noise = Noise(0.0, share * WHEEL, 0.0, share * JOINT_RAD)
    base = extraction_of(robot, route_of(STATIONS, number), noise, seed)
    result = {}
    for how in ("cornerSubPix", "mobilecal"):
        extraction, corner_px = _with_corners(base, number, seed, how)
        try:
            fit = maximum_likelihood(extraction)
        except SolveError:
            result[how] = (np.full(9, np.nan), np.nan, corner_px)
            continue
        found = fit.lin.state.parameters
        result[how] = (errors(found, robot), nees(found, fit.covariance, robot), corner_px)
    return result


def main(runs: int = RUNS) -> str:
    """Table 4, with the usual noise of wheels and joints and with a hundredth of it."""
    text = []
    for quiet in (False, True):
        found = results_of(one_run, quiet, seeds=range(runs))
        noise = "as in the [results](results.md#maximum-likelihood-against-the-truth)"
        if quiet:
            noise = "reduced to a hundredth"
        title = f"Wheel and joint noise {noise}, {runs} runs of N = {STATIONS}; root-mean-square errors."
        rows, size = [], {}
        for how in ("cornerSubPix", "mobilecal"):
            error = np.array([f[how][0] for f in found])
            size[how] = rms(error) * DEGREES_MM
            rows.append([how, *numbers(size[how], 4)])
        rows.append(["mobilecal / cornerSubPix", *numbers(size["mobilecal"] / size["cornerSubPix"])])
        text.append(paragraph(title) + table(["", *NINE_COLUMNS], rows).rstrip("\n"))
        figures = [
            f"{how}: corners {rms([f[how][2] for f in found]):.4f} px, mean NEES / 9 "
            f"{np.nanmean([f[how][1] for f in found]):.3f}, {sum(not np.isfinite(f[how][1]) for f in found)} runs refused"
            for how in ("cornerSubPix", "mobilecal")
        ]
        text.append("\n" + paragraph("; ".join(figures) + ".").rstrip("\n") + "\n")
    return "\n".join(text)
