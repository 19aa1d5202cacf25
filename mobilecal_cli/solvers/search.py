"""The search for the mistake because of which a recording does not fit: one scorer for all hypotheses.

The scorer solves the readings without the mistake by the linear method and a few steps of eq. 19 on the board's poses,
without the worst legs. A cause is named only if the corrected readings fit as recordings fit.
"""

from __future__ import annotations

import math
from collections.abc import Iterator
from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np

from mobilecal_cli import se3
from mobilecal_cli.camera import undistorted
from mobilecal_cli.errors import SolveError
from mobilecal_cli.kinematics import FEWEST_LEGS
from mobilecal_cli.likelihood.constants import kind_of
from mobilecal_cli.likelihood.measurements import MotionPairs
from mobilecal_cli.model.arrays import FloatArray, IntArray
from mobilecal_cli.model.calibration import Parameters
from mobilecal_cli.model.findings import Diagnosis
from mobilecal_cli.model.observations import Extraction
from mobilecal_cli.model.rig import Camera, Rig, WheelGeometry
from mobilecal_cli.solvers.hypotheses import (
    ANY_WHEELS,
    FREE_PARTS,
    FROZEN,
    LATE,
    MOTIONS,
    MOVED,
    SIDES,
    TWO,
    WHOLE,
    Stages,
    interruptions,
    late_readings,
    of_one_recording,
    of_sides,
)
from mobilecal_cli.solvers.initial import ROUNDS, linear_estimate, linear_with_prior
from mobilecal_cli.solvers.linear import NominalPrior, Rounds, nominal_of, ratios_of
from mobilecal_cli.solvers.readings import FEWEST_STATIONS, Readings, readings_of
from mobilecal_cli.solvers.transfer import dead_reckoned, leg_rms_m, point_rms_m, refine_lm

#: Misfit of recordings that fit: up to 0.012 with noisy wheels, 0.3 px, and constants as far off as their priors.
FITS = 0.02
_FITS_CHANGED = FITS / 2  # the parts before and after a change
_FITS_TWO = FITS / 2  # two mistakes: there are many pairs
_FITS_LATE = 5 * FITS  # rotations of another time: no leg is as even as that supposes
_FITS_FREE = FITS / 4  # with a free part: it takes up other mistakes too, but never to the level of the noise
_BETTER = 0.4  # and at most this share of the misfit without the correction
_EQUAL = 1.5  # hypotheses whose misfits differ by less cannot be distinguished
_SAME_RAD = 0.5  # unless one of them turns the camera further from its nominal rotation by more than this
_USED = 0.8  # share of the legs that must fit; the others may be outliers
_PROMISING = 10 * FITS  # linear solutions beyond this are not refined
_LEAST_GAIN = 1e-6  # of a step to their minimum, relative: less changes no decision
_MOST_LEGS = 40  # that are scored, spread over the recording: the time does not grow with its length
_OUTLIERS_IN_PART = 2  # with so many stations of the other part, one may still fit
_CHANGED_SCALE = 0.05  # of a wheel's readings: less is noise of the linear method on a few stations
_CARRIED, _LESS = (
    0.05,
    10.0,
)  # the way of a base that carries the board, over the distance; by such smaller wheels
_ALIKE = 0.05  # share of the wheels' rotations on legs that are alike
_SAME_VIEW = 0.01  # rad, and share of the distance: motion that moves the image by a few pixels
# Two boards by nominal values: how near to its place each is and how far apart they are, as shares; least changes
_SAME_BOARD, _BOARDS_APART, _FEWEST_CHANGES = 0.3, 0.1, 3
_AROUND_RAD = 2.5  # from the nominal rotation: more than an optical frame from a body frame
_OTHER_WHEELS = 3.0  # times the nominal radius: no tire differs by so much
_UNITS = np.geomspace(1 / 64, 64, 33)  # times the nominal radii, to start from
_ALIKE_SIZES = 0.2  # nominal sizes are a few percent off, each by itself
_SAME_UNIT_M = 0.05  # from a radius of 1 m: far more than its uncertainty, and no other unit is so near
# A focal length is another one if the images show it so many standard deviations and by such a factor away: the
# likelihood estimates what is nearer, and names it. The distortion changes with the focal length: some rounds converge.
_FOCAL_SIGMAS, _FOCAL_FACTOR, _FOCAL_ROUNDS = 5.0, 1.25, 5


@dataclass(frozen=True, slots=True)
class _Score:
    """A fit of some readings.

    Attributes:
        misfit, of_all: rms of the corners' transfer error over the distance to the board, of most legs and of all.
        turned_rad: the camera's turn from its nominal rotation.
        wheels: those of the fit.
        carried: with these wheels, the base stays where it is, and the board with it.
        possible: all of them positive and not so, or motion that does not show all parameters.
    """

    misfit: float
    of_all: float
    turned_rad: float
    wheels: WheelGeometry
    carried: bool
    possible: bool


@dataclass(frozen=True, eq=False)
class Search:
    """The search for the mistake or two because of which a recording does not fit; each step is made once, when needed.

    Args:
        extraction: a recording of a target with at least three legs.
    """

    extraction: Extraction

    @cached_property
    def _readings(self) -> Readings:
        return readings_of(self.extraction)

    @cached_property
    def _scores_as_is(self) -> list[_Score]:
        readings = self._readings
        scores, nominal = self._scores(readings, readings.nominal), readings.nominal
        if not any(score.misfit < FITS for score in scores) and nominal.wheels is not None and readings.roams:
            # Turns are seen modulo a full one: far from the readings' unit, the nominal wheels mislead.
            for times in () if readings.distinguishes else _UNITS:
                scaled = WheelGeometry.of(nominal.wheels.vector * [times, times, 1.0])
                scores += self._scores(readings, replace(nominal, wheels=scaled))
        return sorted(scores, key=lambda score: score.misfit)

    @property
    def _as_is(self) -> _Score | None:
        return next((score for score in self._scores_as_is if score.possible), None)

    @property
    def _fits(self) -> bool:
        return self._as_is is not None and self._as_is.misfit < FITS

    @property
    def _base(self) -> float | None:
        """Misfit of the readings as they stand; None if nothing fits them, or if their motion does not show it."""
        shown = self._readings.distinguishes or self.extraction.motions
        return self._as_is.misfit if self._as_is is not None and shown else None

    @cached_property
    def misfit(self) -> float | None:
        """Misfit of most legs over the distance to the board; None if they fit, or the motion does not show it."""
        least = min((score.misfit for score in self._scores_as_is), default=0.0)
        return least if least >= FITS else None

    @property
    def other_wheels(self) -> Diagnosis | None:
        """Another unit of the wheels, with which all fits; None where the base does not drive and turn."""
        if self._as_is is None or not self._fits or not self._readings.motion.shows_wheels:
            return None
        return other_wheels(self._as_is.wheels, self._readings.rig.nominal.wheels)

    @property
    def carried(self) -> Diagnosis | None:
        """The board stays where it is against the base, while the wheels turn."""
        if not any(score.carried and score.misfit < FITS for score in self._scores_as_is):
            return None
        target = "target" if self._readings.measured else "board"
        return Diagnosis(
            f"the {target} stays where it is against the base, but the wheels turn",
            f"check that the {target} does not move with the robot, and that the wheels are on the ground",
        )

    @cached_property
    def of_whole(self) -> Diagnosis | None:
        """The mistake in all readings; None if they fit, or if none of the known ones explains them."""
        at_rest = _same_view(self._readings) or self.carried
        if at_rest is None and self._fits:
            return self.other_wheels
        if self.extraction.motions:
            return (
                at_rest
                or self._named(self._readings, MOTIONS)
                or self._named(self._readings, LATE, _FITS_LATE)
            )
        return (
            at_rest
            or self._named(self._readings, WHOLE)
            or other_focal_lengths(self.extraction)
            or self._with_late_readings()
            or self._named(self._readings, TWO, _FITS_TWO)
        )

    @cached_property
    def diagnosis(self) -> Diagnosis | None:
        """The mistake in all readings, or else in some: of one recording, from a station on, or of one sensor."""
        if self.of_whole is not None:
            return self.of_whole
        if self.extraction.motions:
            return None
        if len(self._readings.wheels) > 1:  # most legs may fit without those of a short recording
            return self._of_one_log() or self._named(self._readings, ((of_one_recording,),))
        if self._fits:
            return None
        last = self._free_part if self._readings.consistent else self._images
        return _two_boards(self._readings) or self._from_a_station_on or self.frozen or last()

    @cached_property
    def interrupted(self) -> Diagnosis | None:
        """The reading that stays the same for a stretch, without which all legs fit clearly better, not most alone."""
        as_is = self._as_is
        if as_is is None:
            return None
        for row in interruptions(self._readings):
            fit = self._score(row.transform(self._readings))
            if fit is not None and fit.misfit < FITS and fit.of_all < _BETTER * as_is.of_all:
                return Diagnosis(row.cause, row.cure, self._base, fit.of_all)
        return None

    @cached_property
    def frozen(self) -> Diagnosis | None:
        """The joint whose reading never changes while the images show that it moves, and not once in the middle."""
        if not self._readings.consistent or self._from_a_station_on is not None:
            return None
        return self._named(self._readings, FROZEN, _FITS_FREE)

    def _with_late_readings(self) -> Diagnosis | None:
        """A wrong sign, side or unit where clocks differ, too, by as much as images in motion show."""
        if all(o.at_rest for o in self.extraction.observations):
            return None
        shifted = (readings for readings in late_readings(self._readings))
        return next(filter(None, (self._named(each, WHOLE[:1]) for each in shifted)), None)

    def _images(self) -> Diagnosis:
        """Images that do not even show the board as a board: what moves the robot explains nothing then."""
        several = len(self._readings.rig.cameras.names) > 1
        return Diagnosis(
            f"the images of a station do not fit camera_info and the board{', or one another' * several}: the "
            f"reprojection error is {self._readings.reprojection_px:.2g} px at most stations (usual: 0.3 px)",
            "check that camera_info is of these cameras and of this resolution, the board's size"
            f"{', that the images of all cameras are of one moment, and that no camera moved' * several}",
            self._base,
        )

    def _free_part(self) -> Diagnosis | None:
        """The one sensor whose readings say nothing.

        Wheels that may read anything explain wrong readings of a joint that turns as the base does, too, and such a
        joint explains what short drives show of wrong wheels: both are named where the wheels explain clearly more.
        """
        joint, drive = (self._named(self._readings, (stage,), _FITS_FREE) for stage in FREE_PARTS)
        if joint is None or drive is None:
            return joint or drive
        of_joint, of_drive = (fit.corrected_share or 0.0 for fit in (joint, drive))
        if of_joint < _EQUAL * of_drive:
            return joint
        return replace(drive, cause=f"{joint.cause}; or {drive.cause}", cure=f"{joint.cure}; or {drive.cure}")

    @cached_property
    def _starts(self) -> list[FloatArray]:
        """Wheel ratios to start from: the nominal ones or any, and those of the readings as they stand."""
        nominal = self._readings.rig.nominal.wheels
        starts = [ratios_of(nominal or ANY_WHEELS)]
        if self._readings.distinguishes:
            try:
                linear = linear_estimate(_thinned(self._readings), nominal).parameters
                starts.append(np.abs(ratios_of(linear.wheels)) * [1.0, -1.0])
            except (SolveError, np.linalg.LinAlgError):
                pass
        return starts

    def _score(self, readings: Readings) -> _Score | None:
        """The best possible fit of some readings; None without one.

        Motion that does not show all parameters fits many mistakes: only the readings as they stand are scored there.
        """
        return next((score for score in self._scores(readings, readings.nominal) if score.possible), None)

    def _scores(self, readings: Readings, nominal: NominalPrior) -> list[_Score]:
        """A fit of some readings from each start, or from nominal values, the best first."""
        full, shown = readings.distinguishes, readings.roams
        if not (shown or readings is self._readings):
            return []
        pairs = _thinned(readings)
        distance_m = float(np.linalg.norm(pairs.points_c, axis=-1).mean())
        scores: list[_Score] = []
        for ratios in self._starts if full else [np.zeros(2)]:
            try:
                parameters = (
                    Rounds(pairs).after(ratios, ROUNDS)
                    if full
                    else linear_with_prior(pairs, nominal, readings.motion)
                )
                misfit, kept = _misfit(pairs, parameters, distance_m)
                if misfit < _PROMISING:
                    parameters = refine_lm(pairs.select(kept), parameters, _LEAST_GAIN).parameters
                    misfit, _ = _misfit(pairs, parameters, distance_m)
            except (SolveError, np.linalg.LinAlgError):
                continue
            X = parameters.T_h_c if nominal.T_h_c is None else nominal.T_h_c
            turn = X[:3, :3].T @ parameters.T_h_c[:3, :3]
            of_all = point_rms_m(pairs, parameters) / distance_m
            radii_m = np.abs(parameters.wheels.vector[:2])
            carried = shown and float((pairs.steps.totals_rad * radii_m).max()) < _CARRIED * distance_m
            carried &= nominal.wheels is None or bool(radii_m.max() * _LESS < nominal.wheels.vector[:2].min())
            possible = not shown or (parameters.wheels.positive and not carried)
            possible &= not len(readings.motions) or bool(
                X[:3, 2] @ parameters.T_h_c[:3, 2] > 0
            )  # z stays up
            turned_rad = float(np.linalg.norm(se3.log_so3(turn)))
            scores.append(_Score(misfit, of_all, turned_rad, parameters.wheels, carried, possible))
        return sorted(scores, key=lambda score: score.misfit)

    def _limit(self, fits: float) -> float:
        return fits if self._base is None else min(_BETTER * self._base, fits)

    def _named(self, readings: Readings, stages: Stages, fits: float = FITS) -> Diagnosis | None:
        """The hypotheses of the first stage with which the readings fit, about as well as with the best one."""
        limit = self._limit(fits)
        # Turned around, a camera on the base fits both wheels reversed as well as it fits them as they are.
        farthest = math.inf if readings.rig.chain.joints else _AROUND_RAD
        for stage in stages:
            scored = [
                (self._score(row.transform(readings)), row) for family in stage for row in family(readings)
            ]
            fitting = [
                (fit, row)
                for fit, row in scored
                if fit is not None and fit.misfit < limit and fit.turned_rad < farthest
            ]
            if not fitting:
                continue
            least = min(fit.misfit for fit, _ in fitting)
            equal = [(fit, row) for fit, row in fitting if fit.misfit < _EQUAL * least]
            nearest = min(fit.turned_rad for fit, _ in equal)
            named = [row for fit, row in equal if fit.turned_rad < nearest + _SAME_RAD]
            causes, cures = (dict.fromkeys(getattr(row, name) for row in named) for name in ("cause", "cure"))
            return Diagnosis(" or ".join(causes), ", or ".join(cures), self._base, least)
        return None

    def _of_one_log(self) -> Diagnosis | None:
        """The mistake of one of several recordings."""
        logs = len(self.extraction.wheels)
        for log in range(logs):
            alone = self.extraction.of_log(log)
            diagnosis = Search(alone).diagnosis if len(alone.observations) > FEWEST_LEGS else None
            if diagnosis is not None:
                cause = f"recording {log + 1} of {logs}: {diagnosis.cause}"
                return replace(diagnosis, cause=cause, cure=f"{diagnosis.cure}, for this recording only")
        return None

    @cached_property
    def _from_a_station_on(self) -> Diagnosis | None:
        """A change: the first stations fit on their own, and the others too, or without a mistake."""
        readings, limit = self._readings, self._limit(_FITS_CHANGED)
        count = len(readings.log)
        if count < 2 * FEWEST_STATIONS:
            return None

        def fit_of(part: slice) -> _Score | None:
            fit = self._score(readings.of(part))
            return fit if fit is not None and fit.of_all < limit else None

        low, high = FEWEST_STATIONS, count - FEWEST_STATIONS
        while low < high:  # the most first stations that fit
            middle = (low + high + 1) // 2
            low, high = (middle, high) if fit_of(slice(middle)) else (low, middle - 1)
        # A part may fit with an outlier of the other one.
        for cut in range(low, max(low - _OUTLIERS_IN_PART, FEWEST_STATIONS) - 1, -1):
            before = fit_of(slice(cut))
            if before is None:
                continue
            others = readings.of(slice(cut, None))
            diagnosis = _same_view(others)
            after = None if diagnosis is not None else fit_of(slice(cut, None))
            # Turned around, a camera on the base fits readings with the other sign.
            alike = after is not None and abs(after.turned_rad - before.turned_rad) < _AROUND_RAD
            diagnosis = diagnosis if diagnosis or alike else self._named(others, WHOLE[:1])
            if diagnosis is not None:
                return replace(diagnosis, cause=f"from about {readings.at_s(cut)} s on, {diagnosis.cause}")
            if after is not None:
                return self._change(cut, before, after)
        return None

    def _change(self, cut: int, before: _Score, after: _Score) -> Diagnosis:
        """What changes where all stations before the cut fit, and all after it."""
        readings, misfit = self._readings, max(before.misfit, after.misfit)
        log = (np.arange(len(readings.log)) >= cut).astype(np.int64)
        apart = self._score(replace(readings, log=log, wheels=readings.wheels * 2))
        if apart is not None and apart.misfit < _EQUAL * misfit:
            what = "the readings of the wheels jump, or the board or the robot is moved by hand,"
        else:  # larger readings look like smaller wheels
            factors = before.wheels.vector[:2] / after.wheels.vector[:2]
            what = " and ".join(
                f"the {side} wheel's readings become {factor:.2g} times as large"
                for side, factor in zip(SIDES, factors.tolist(), strict=True)
                if abs(factor - 1) > _CHANGED_SCALE
            )
        some = (
            "a wheel, a joint or a camera changes"
            if readings.rig.chain.joints
            else "a wheel or a camera changes"
        )
        return Diagnosis(
            f"{what or some} between {readings.at_s(cut - 1)} and "
            f"{readings.at_s(cut)} s: the recording fits before and after, but not as a whole",
            "check the wheels, the head, the cameras and the board at this time, and record again without the change",
            self._base,
            misfit,
        )


def _thinned(readings: Readings) -> MotionPairs:
    legs = readings.legs
    if legs <= _MOST_LEGS:
        return readings.pairs
    some = np.linspace(0, legs - 1, _MOST_LEGS).round().astype(np.int64)
    if len(readings.motions):  # each is a recording
        return readings.of(np.isin(readings.log, some)).pairs
    return readings.pairs.select(some)


def _misfit(pairs: MotionPairs, parameters: Parameters, distance_m: float) -> tuple[float, IntArray]:
    """Rms of the corners' transfer error over the distance, on the legs that fit best, and these legs."""
    each_m = leg_rms_m(pairs, parameters)
    kept = np.sort(np.argsort(each_m)[: math.ceil(_USED * len(each_m))])
    return math.sqrt(float(np.mean(each_m[kept] ** 2))) / distance_m, kept


# -- what needs no fit ------------------------------------------------------------------------------


def _same_view(readings: Readings) -> Diagnosis | None:
    """All stations show the board at the same place while joints or wheels move."""
    turned, motions = readings.pairs.steps.totals_rad, len(readings.motions) > 0
    views = readings.T_c_k[readings.pairs.legs[:, 1]] if motions else readings.T_c_k
    away = se3.inverse(views[0]) @ views
    distance_m = float(np.linalg.norm(views[0, :3, 3]))
    still = np.linalg.norm(se3.log_so3(away[:, :3, :3]), axis=-1).max() < _SAME_VIEW
    still &= np.linalg.norm(away[:, :3, 3], axis=-1).max() < _SAME_VIEW * distance_m
    most_rad = np.abs(turned).max(initial=0.0)
    moves = np.ptp(turned, axis=0).max() - _ALIKE * most_rad if motions else most_rad
    if not still or max(moves, np.ptp(readings.joints, axis=0).max(initial=0.0)) <= MOVED:
        return None
    if motions:
        return Diagnosis(
            "all motions are the same, but the wheels turn otherwise on each leg",
            "give the motion of each leg: check that the sensor is not frozen",
        )
    return Diagnosis(
        "all stations show the board at the same place, but the base or the head moves",
        "check that the images are not frozen, and that the board does not move with the robot",
    )


def _two_boards(readings: Readings) -> Diagnosis | None:
    """A board that moves to and fro between two places by dead reckoning with nominal values: there are two."""
    X, wheels = readings.nominal.T_h_c, readings.nominal.wheels
    if X is None or wheels is None:
        return None
    pairs, center_k = readings.pairs, readings.corners_k.mean(axis=0)
    T_w_k = dead_reckoned(pairs, wheels) @ pairs.T_v_h @ X @ readings.T_c_k
    T_ki_kj = se3.inverse(T_w_k[pairs.legs[:, 0]]) @ T_w_k[pairs.legs[:, 1]]
    moved_m = T_ki_kj[:, :3, :3] @ center_k + T_ki_kj[:, :3, 3] - center_k
    size_m = np.linalg.norm(moved_m, axis=1)
    side = np.sign(moved_m @ moved_m[np.argmax(size_m)]) * (size_m > size_m.max() / 2)
    step_m = np.median((side[:, None] * moved_m)[side != 0], axis=0)
    apart_m = float(np.linalg.norm(step_m))
    fits = np.linalg.norm(moved_m - side[:, None] * step_m, axis=1) < _SAME_BOARD * apart_m
    changes = side[fits & (side != 0)]
    distance_m = float(np.linalg.norm(pairs.points_c, axis=-1).mean())
    if (
        len(changes) < _FEWEST_CHANGES
        or np.any(changes[1:] == changes[:-1])
        or fits.mean() < _USED
        or apart_m < _BOARDS_APART * distance_m
    ):
        return None
    return Diagnosis(
        f"two boards {apart_m:.1f} m apart are in view alternately, {len(changes)} times",
        "cover one of them, and record again",
    )


def turned_around(rig: Rig, T_h_c: FloatArray, measured: bool) -> Diagnosis | None:
    """A camera on the base that is upside down or looks back against its nominal pose: wheels that are exchanged.

    A planar drive with exchanged or reversed wheels fits as well as the right one, with the base turned by 180 degrees.
    """
    nominal = nominal_of(rig).T_h_c
    if rig.chain.joints or nominal is None:
        return None
    turn = T_h_c[:3, :3] @ nominal[:3, :3].T
    if float(np.linalg.norm(se3.log_so3(turn))) < _AROUND_RAD:
        return None
    upside_down, backward = bool(turn[2, 2] < 0), bool(turn[0, 0] < 0)
    # Upside down, the base turns the other way; turned about the vertical, it drives backwards and turns as before.
    cause, cure = of_sides(rig, upside_down != backward, ("right", "left") if backward else ())
    one = len(rig.cameras.names) == 1 and not measured
    return Diagnosis(
        f"{cause}, or the nominal pose of the camera is that of another frame{', or the images are mirrored' * one}",
        f"{cure}, or correct nominal.head_eye{', or turn off mirroring in the driver of the camera' * one}",
    )


def other_wheels(wheels: WheelGeometry, nominal: WheelGeometry | None) -> Diagnosis | None:
    """Wheel radii with which the recording fits but which are several times the nominal ones: another unit."""
    if nominal is None:
        return None
    radii_m = wheels.vector[:2]
    ratios = radii_m / nominal.vector[:2]
    factor = float(np.mean(np.abs(ratios)))
    right, left = (f"{1e3 * radius_m:.4g}" for radius_m in radii_m)
    times = f"{float(f'{factor:.2g}'):g} times the nominal ones"
    if 1 / _OTHER_WHEELS < factor < _OTHER_WHEELS:
        if ratios[0] * ratios[1] > 0:
            return None
        return Diagnosis(
            f"the wheel radii that fit are {right} and {left} mm: one of the wheels counts in the other direction",
            "negate wheels.left.sign or wheels.right.sign in rig.yaml: readings increase when driving forward",
        )
    wider = abs(wheels.separation_m) / nominal.separation_m
    if abs(wider / factor - 1) < _ALIKE_SIZES:  # readings in another unit leave the separation as it is
        return Diagnosis(
            f"radii and separation that fit are all {times} (radii {right} and {left} mm)",
            "check the unit of board.square_m, of the camera poses and of nominal.wheels: all are in m",
        )
    unit = " (1 m: the readings are in meters)" if abs(radii_m - 1).max() < _SAME_UNIT_M else ""
    unit = " (1/57: the readings are in degrees)" if abs(math.degrees(factor) - 1) < _ALIKE_SIZES else unit
    return Diagnosis(
        f"the wheel radii that fit are {right} and {left} mm, {times}{unit}",
        "check the unit and the ticks_per_revolution of the wheel readings (radians are expected), and a gear ratio",
    )


def other_focal_lengths(extraction: Extraction) -> Diagnosis | None:
    """A camera whose images of the board alone show focal lengths that are far from those of its camera_info."""
    cameras = extraction.rig.cameras
    if extraction.motions:
        return None
    for number, (name, camera) in enumerate(zip(cameras.names, cameras.each, strict=True)):
        views = [o.views[number] for o in extraction.observations]
        whole = np.array([view.pixels for view in views if view.seen.all()])
        grid = extraction.board.grid().reshape(-1, 3)[:, :2]
        factor, sigma = _focal_factor(camera, whole, grid)
        others = (_focal_factor(changed, whole, shape)[0] for changed, shape in _a_sigma_off(camera, grid))
        sigma = math.hypot(sigma, *(other / factor - 1 for other in others))
        away = max(factor, 1 / factor)
        if away > _FOCAL_FACTOR and away - 1 > _FOCAL_SIGMAS * sigma * away:
            return Diagnosis(
                f"the {name} images show focal lengths of about {factor:.2g} times those in camera_info, "
                "which belongs to another resolution or zoom",
                "record the camera_info of these images, or calibrate the camera with them",
            )
    return None


def _a_sigma_off(camera: Camera, grid: FloatArray) -> Iterator[tuple[Camera, FloatArray]]:
    """A camera and a board (M, 2) that differ by a prior sigma from the stated ones, in what all images have in common.

    Where all show the board alike, as with a camera on the base, that counts more than their scatter.
    """
    point, aspect, shear = (
        kind_of(name).sigma for name in ("principal_point", "square_aspect", "board_shear")
    )
    for axis in range(2):
        K = camera.K.copy()
        K[axis, 2] += point * camera.width
        yield replace(camera, K=K), grid
    yield camera, grid * [1 + aspect, 1.0]
    yield camera, grid @ np.array([[1.0, 0.0], [shear, 1.0]])


def _focal_factor(camera: Camera, pixels: FloatArray, grid: FloatArray) -> tuple[float, float]:
    """Focal lengths that images of a board show, over the stated ones, and the relative standard deviation.

    Each homography from the board has orthogonal columns of equal length in coordinates at z = 1 (Zhang 2000).

    Args:
        camera: principal point, aspect and distortion are used as stated.
        pixels: (n, M, 2) px.
        grid: (M, 2) corners on the board, in any unit.
    """
    if len(pixels) < FEWEST_STATIONS:
        return 1.0, math.inf
    centered = grid - grid.mean(axis=0)
    plane = np.insert(centered / np.abs(centered).max(), 2, 1.0, axis=1)
    factor, sigma = 1.0, math.inf
    for _ in range(_FOCAL_ROUNDS):
        K = camera.K * (1 + (factor - 1) * np.diag([1.0, 1.0, 0.0]))
        H = _homographies(plane, undistorted(replace(camera, K=K), pixels)[0])
        across, ahead = H[:, :2, :2], H[:, 2, :2]
        # across^T across / f^2 + ahead ahead^T is a multiple of the unit matrix, with f over that of K.
        of_f, rest = (
            np.concatenate([M[:, 0, 1], M[:, 0, 0] - M[:, 1, 1]])
            for M in (across.mT @ across, ahead[:, :, None] * ahead[:, None])
        )
        information = float(of_f @ of_f)
        inverse_square = -float(of_f @ rest) / information if information else 0.0
        if inverse_square <= 0:  # a board that is never seen obliquely shows none
            return 1.0, math.inf
        errors = of_f * inverse_square + rest
        factor /= math.sqrt(inverse_square)
        sigma = math.sqrt(float(np.mean(errors**2)) / information) / (2 * inverse_square)
    return factor, sigma


def _homographies(plane: FloatArray, seen: FloatArray) -> FloatArray:
    """(n, 3, 3) homographies from (M, 3) points of a plane to (n, M, 2) images, with 1 in the last place (DLT)."""
    points = np.broadcast_to(plane, (*seen.shape[:2], 3))
    zero = np.zeros_like(points)
    along_x = np.concatenate([points, zero, -points * seen[..., :1]], axis=2)
    along_y = np.concatenate([zero, points, -points * seen[..., 1:]], axis=2)
    H = np.linalg.svd(np.concatenate([along_x, along_y], axis=1), full_matrices=False)[2][:, -1]
    return np.asarray((H / H[:, -1:]).reshape(-1, 3, 3), dtype=np.float64)
