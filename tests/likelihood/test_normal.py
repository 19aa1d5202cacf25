"""The eliminated normal equations against dense ones, whose Jacobian is numerical."""

from dataclasses import replace
from functools import cached_property

import numpy as np
import pytest

from mobilecal_cli.likelihood import budget
from mobilecal_cli.likelihood.constants import floors_of, table
from mobilecal_cli.likelihood.corners import corner_residuals
from mobilecal_cli.likelihood.dataset import Inliers, dataset_of
from mobilecal_cli.likelihood.legs import linearize_legs
from mobilecal_cli.likelihood.measurements import ENCODERS, JOINTS, STAMP, SWAY
from mobilecal_cli.likelihood.normal import _none_negative, eliminated
from mobilecal_cli.likelihood.posterior import Posterior
from mobilecal_cli.likelihood.state import Step
from mobilecal_cli.likelihood.views import roots, summed
from mobilecal_cli.model.rig import Board
from mobilecal_cli.model.solution import Noise
from mobilecal_cli.simulate.robot import PAPER_ROBOT
from mobilecal_cli.simulate.route import plan_route
from mobilecal_cli.solvers.initial import start_state
from tests import extractions
from tests.robots import chain_of
from tests.truth import no_priors, parameters_of

NOISE = Noise(
    pixel_px=0.2,
    wheel_rad_per_sqrt_rad=0.003,
    encoder_rad=0.01,
    joint_rad=np.radians(0.05),
    floor_rad=0.002,
    floor_m=0.0005,
    stamp_s=0.001,
    pair_s=0.003,
    shift_px=0.05,
    wheel_share=0.002,
    floor_length_m=0.4,
    wheel_length_m=0.7,
    sway_rad=0.0003,
    sway_m=0.0002,
    pose_scale=1.0,
    wider={},
)
STATIONS = 6


class Case:
    """A linearization at a random state, with dense normal equations in (shared, boards, base blocks, own errors)."""

    def __init__(self):
        robot, logs = PAPER_ROBOT, 2
        constants = (*table(robot.rig_cameras, chain_of(robot)), *floors_of(range(logs)))
        route = plan_route(robot, "moving", STATIONS, Board(5, 4, 0.1))
        disturbed = extractions.Noise(0.2, 0.003)  # the tracks of exact joints have derivatives
        extraction = extractions.extraction_of(robot, route, disturbed, seed=1)
        seen = extraction.observations[:STATIONS]
        seen = tuple(replace(o, log=k * logs // len(seen)) for k, o in enumerate(seen))
        tracks = {"wheels": extraction.wheels * logs, "joint_tracks": extraction.joint_tracks * logs}
        extraction = replace(extraction, observations=seen, **tracks)
        # The left wheel's encoder is four times finer.
        steps = {"encoder_step_rad": np.array([0.02, 0.005])}
        self.data = replace(dataset_of(extraction, constants), **steps)
        everything = Inliers.all_of(self.data)
        legs, views, readings = (getattr(everything, name).copy() for name in ("legs", "views", "readings"))
        legs[1 + logs], views[3], readings[4, 0] = False, False, False
        inliers = replace(everything, legs=legs, views=views, readings=readings)
        truth = start_state(self.data, parameters_of(robot), everything)
        random = np.random.default_rng(0)
        self.width = self.data.base_width
        stations = self.width * STATIONS, self.data.own_width * STATIONS
        self.sizes = (self.data.layout.size, 6 * logs, *stations)
        base = random.normal(size=(STATIONS, self.width)) * 1e-2
        base[self.data.first, :3] = 0.0
        shared = random.normal(size=self.sizes[0]) * 1e-3
        # The derivative by a clock leaves out how smoothing changes along the way: 1e-3 of it, where wheels jerk.
        shared[self.named("wheel_smoothing")] *= 1e-3
        boards = random.normal(size=(logs, 6)) * 1e-3
        step = Step(shared, boards, base, random.normal(size=(STATIONS, self.data.own_width)) * 1e-2)
        priors = no_priors(self.data.layout, truth.parameters)
        self.lin = Posterior.at(truth.plus(step), inliers, NOISE, priors)

    def displaced(self, x):
        shared, boards, base, own = np.split(x, np.cumsum(self.sizes)[:3])
        stations = base.reshape(STATIONS, -1), own.reshape(STATIONS, -1)
        return self.lin.state.plus(Step(shared, boards.reshape(self.data.logs, -1), *stations))

    def whitened_pixels(self, state):
        off, _ = corner_residuals(state, state.T_c_k, rates=self.lin.rates)
        whitened = np.einsum("ncmab,ncmb->ncma", self.data.whitening, off) / NOISE.pixel_px
        return np.where(self.lin.inliers.used_corners[..., None], whitened, 0.0)

    @cached_property
    def roots_of_own(self):
        """(2, N, 2 M, 2 M) inverse root of the covariance of each camera's residuals, own delays and shifts included."""
        constants, width = self.lin.state.constants, self.data.cameras.each[0].width
        shift = 1e-4, NOISE.shift_px / width
        own = [{"principal_left_x": shift, "principal_left_y": shift}]
        own += [{"principal_right_x": shift, "principal_right_y": shift, "time_right": (1e-5, NOISE.pair_s)}]
        roots = []
        for camera, changes in enumerate(own):
            covariance = np.eye(2 * self.data.pixels.shape[2])
            for name, (step, sigma) in changes.items():
                more, less = (
                    self.whitened_pixels(replace(self.lin.state, constants={**constants, name: at}))
                    for at in constants[name] + np.array([step, -step])
                )
                across = ((more - less)[:, camera] / (2 * step)).reshape(STATIONS, -1, 1)
                covariance = covariance + sigma**2 * across @ across.mT
            values, vectors = np.linalg.eigh(covariance)
            roots.append((vectors / np.sqrt(values)[:, None]) @ vectors.mT)
        return roots

    def residuals(self, x):
        state = self.displaced(x)
        pixels = self.whitened_pixels(state)
        for camera, root in enumerate(self.roots_of_own):
            of_camera = pixels[:, camera].reshape(STATIONS, -1, 1)
            pixels[:, camera] = (root @ of_camera).reshape(pixels[:, camera].shape)
        root = np.zeros_like(self.lin.leg_weight)
        on = self.lin.inliers.legs
        root[on] = np.linalg.cholesky(self.lin.leg_weight[on])
        legs = np.einsum("lba,lb->la", root, linearize_legs(state, self.lin.processes).residual)
        read = np.hypot(NOISE.joint_rad, self.data.joints_between)
        sigma = np.where(self.lin.inliers.readings, read, 1.0)
        encoders = np.hypot(NOISE.encoder_rad * np.array([1, 0.25]), self.data.wheels_between)
        readings = state.own[:, JOINTS] / sigma, state.base[:, ENCODERS] / encoders
        sway = state.own[:, SWAY] / [NOISE.sway_rad, NOISE.sway_rad, NOISE.sway_m]
        along, stamps = self.innovations(state.base[:, 5:10]), state.base[:, STAMP:] / NOISE.stamp_s
        errors = *readings, sway, along, stamps
        return np.concatenate([part.ravel() for part in (pixels, legs, *errors)])

    def innovations(self, values):
        """Of each process from its covariance sigma^2 exp(-d / l) in closed form, whitened."""
        sigma = [NOISE.floor_rad, NOISE.floor_rad, NOISE.floor_m, NOISE.wheel_share, NOISE.wheel_share]
        lengths = [NOISE.floor_length_m] * 3 + [NOISE.wheel_length_m] * 2
        parts = []
        for k in range(5):
            at = np.cumsum(self.lin.processes.distance_m[:, 2 + k])
            joined = self.data.legs[self.lin.inliers.legs, 1]
            cut = np.cumsum(~np.isin(np.arange(STATIONS), joined))
            cov = sigma[k] ** 2 * np.exp(-np.abs(at[:, None] - at) / lengths[k]) * (cut[:, None] == cut)
            parts.append(np.linalg.solve(np.linalg.cholesky(cov), values[:, k]))
        return np.concatenate(parts)

    def named(self, begin):
        """(P,) which of the shared parameters have names that begin so."""
        return np.array([name.startswith(begin) for name in self.data.layout.names])

    @cached_property
    def dense(self):
        size = sum(self.sizes)
        x = np.zeros(size)
        # A step in time far above the stamps' nanosecond, a larger one of floors, which are linear.
        step = np.full(size, 1e-6)
        step[: self.sizes[0]][self.named("floor_")] = 1e-4
        step[: self.sizes[0]][self.named("time_")] = 2e-2
        steps = zip(step, np.eye(size), strict=True)
        columns = [(self.residuals(h * e) - self.residuals(-h * e)) / (2 * h) for h, e in steps]
        J = np.stack(columns, axis=1)
        # The world is the base at the first station of its recording.
        first = self.sizes[0] + self.sizes[1] + self.width * np.flatnonzero(self.data.first)
        gauge = (first[:, None] + np.arange(3)).ravel()
        J[:, gauge] = 0.0
        H, g = J.T @ J, J.T @ self.residuals(x)
        H[gauge, gauge] += 1.0
        return H, g


@pytest.fixture(scope="module")
def case():
    return Case()


def reduced(case, H, g):
    n = case.sizes[0]
    other = np.linalg.solve(H[n:, n:], np.column_stack([H[n:, :n], g[n:]]))
    return H[:n, :n] - H[:n, n:] @ other[:, :n], g[:n] - H[:n, n:] @ other[:, n]


def test_the_cost_is_the_sum_of_squares(case):
    residuals = case.residuals(np.zeros(sum(case.sizes)))
    assert case.lin.cost == pytest.approx(float(residuals @ residuals), rel=1e-10)


def test_elimination_is_exact(case):
    """Schur complement and gradient of every shared parameter, constants included.

    The derivative by a clock's offset is a secant over 40 ms, of curved motion: measured 3e-5 there, 2e-9 elsewhere.
    """
    H, g = case.dense
    S, s = reduced(case, H, g)
    scale = np.sqrt(np.diag(H)[: case.sizes[0]])
    off = np.abs((case.lin.normal.S - S) / np.outer(scale, scale))
    clocks = case.named("time_")
    assert off.max() < 1e-4
    assert off[np.ix_(~clocks, ~clocks)].max() < 1e-6
    wrong, largest = np.abs((case.lin.normal.s - s) / scale), np.abs(s / scale).max()
    assert wrong.max() < 1e-4 * largest
    assert wrong[~clocks].max() < 1e-8 * largest


def test_a_reading_that_is_left_out_costs_the_gradient_no_digits(case):
    """Of sharp corners, it was rounding: fits never converged, and rounds of noise levels wandered, for 100 s."""
    off_rad = np.zeros_like(case.data.joints)
    off_rad[4, 0] = 0.5  # this reading is no inlier
    state = start_state(case.data, parameters_of(PAPER_ROBOT), Inliers.all_of(case.data))
    own = state.own.copy()
    own[:, JOINTS] = off_rad
    state = replace(state, data=replace(case.data, joints=case.data.joints - off_rad), own=own)
    sharp = replace(NOISE, pixel_px=0.005, joint_rad=1e-4, pair_s=1e-5, shift_px=1e-3)
    lin = Posterior.at(state, case.lin.inliers, sharp, case.lin.priors)
    still = np.zeros(case.sizes[0])
    best = lin.extrapolated(eliminated(lin).step(still))
    again = best.extrapolated(eliminated(best).step(still))
    apart = (eliminated(again).s - eliminated(best).s) / np.sqrt(np.diag(lin.normal.S))
    assert np.abs(apart).max() < 1e-8


@pytest.mark.parametrize("damping", [0.1, 100.0])
def test_a_damped_step_gains_what_it_promises_along_the_gradient(case, damping):
    """With another gradient, no damped step decreased the cost: fits ended where one was needed.

    What is promised is that of any step of the shared parameters: here of one that leaves the clocks, see above.
    """
    normal, (_, g) = eliminated(case.lin, damping), case.dense
    shared = -np.linalg.pinv(normal.S, rcond=1e-13, hermitian=True) @ normal.s * ~case.named("time_")
    made = normal.step(shared)
    step = np.concatenate([shared, made.boards.ravel(), made.base.ravel(), made.own.ravel()])
    promised = normal.gain - normal.s @ shared
    assert promised > 0
    assert -g @ step == pytest.approx(promised, rel=1e-6)


def test_rounding_makes_no_information_negative():
    """Corners of 0.006 px, a wheel that changes: a calibration ended with "do not determine all parameters"."""
    rotation = np.linalg.qr(np.random.default_rng(3).normal(size=(4, 4)))[0]
    size = np.sqrt([1e13, 1e10, 1e6, 1.0])
    S = np.outer(size, size) * (rotation @ np.diag([1.0, 0.5, 0.1, -1e-7]) @ rotation.T)
    before = size**2
    kept = _none_negative(S, before, np.zeros(4)) / np.outer(size, size)
    expected = rotation @ np.diag([1.0, 0.5, 0.1, 0.0]) @ rotation.T
    assert np.abs(kept - expected).max() < 1e-14
    assert _none_negative(np.diag(before), before, np.zeros(4)).tolist() == np.diag(before).tolist()
    assert _none_negative(S, before, 1e-6 * before) is S  # priors that say so much more


def test_back_substitution_solves_the_dense_equations(case):
    H, g = case.dense
    n = case.sizes[0]
    step = np.random.default_rng(1).normal(size=n) * 1e-3
    other = np.linalg.solve(H[n:, n:], -g[n:] - H[n:, :n] @ step)
    made = case.lin.normal.step(step)
    found = np.concatenate([made.boards.ravel(), made.base.ravel(), made.own.ravel()])
    # In motion, rates are secants over 40 ms.
    assert np.abs(found - other).max() < 1e-4 * np.abs(other).max()


def information(images):
    """(N, Q, Q) of images whose groups are single stations."""
    rows = images.rows[:, :6]
    return np.concatenate([rows, np.concatenate([rows[:, :, 6:].mT, images.direct], axis=2)], axis=1)


class TestImages:
    """Sums over recordings against the images station by station."""

    @pytest.fixture
    def both(self, case):
        return case.lin.views, case.lin.changed(apart=True).views

    @staticmethod
    def same(summed, apart):
        """Whether both say the same, of each station and of each recording."""
        by_log = np.eye(summed.group.max() + 1)[summed.group]
        for name in ("rows", "pull", "cost"):
            scale = np.abs(getattr(apart, name)).max()
            assert getattr(summed, name) == pytest.approx(getattr(apart, name), abs=1e-11 * scale)
        for name in ("direct", "gradient"):
            expected = np.tensordot(by_log.T, getattr(apart, name), 1)
            assert getattr(summed, name) == pytest.approx(expected, abs=1e-11 * np.abs(expected).max())

    def test_sums(self, both):
        self.same(*both)

    def test_rows_are_those_of_the_whole_information(self, both):
        apart = both[1]
        assert information(apart)[:, apart.traced] == pytest.approx(apart.rows, rel=1e-9, abs=1e-3)
        assert information(apart) == pytest.approx(information(apart).mT, rel=1e-9, abs=1e-3)

    def test_noise(self, case):
        for more in ({"pixel_px": 3.0}, {"pair_s": 0.02, "shift_px": 0.02}, {"pair_s": 0.0, "shift_px": 0.0}):
            lin = case.lin.with_noise(replace(NOISE, **more))
            self.same(lin.views, lin.changed(apart=True).views)

    @pytest.mark.parametrize("more", [{"pair_s": 0.02}, {"shift_px": 1.0}])
    def test_what_images_have_of_their_own_is_less_to_go_by(self, case, more):
        """The information of images that vary more is less, in all directions."""
        here = case.lin.views
        there = case.lin.with_noise(replace(NOISE, **more)).views
        taken = here.direct - there.direct
        scale = np.abs(here.direct).max()
        assert taken.max() > 1e-3 * scale
        assert np.linalg.eigvalsh(taken).min() > -1e-9 * scale

    def test_a_step_of_all(self, case, both):
        """The cost of a recording; its stations share what the direct constants change."""
        random = np.random.default_rng(2)
        traced = 1e-3 * random.normal(size=both[0].pull.shape)
        direct = 1e-3 * random.normal(size=both[0].gradient.shape[1])
        summed, apart = (images.shifted(traced, direct) for images in both)
        of_log = np.eye(case.data.logs)[case.data.log].T
        assert of_log @ summed.cost == pytest.approx(of_log @ apart.cost, rel=1e-10)
        self.same(replace(summed, cost=apart.cost), apart)
        shift = np.zeros((STATIONS, information(apart).shape[1]))
        shift[:, apart.traced], shift[:, 6:] = traced, shift[:, 6:] + direct
        shift[:, apart.traced[6:]] = traced[:, 6:] + direct[apart.traced[6:] - 6]
        gradient = np.concatenate([both[1].pull[:, :6], both[1].gradient], axis=1)
        change = np.einsum("nqr,nr->nq", information(both[1]), shift)
        expected = both[1].cost + np.sum(shift * (2 * gradient + change), axis=1)
        assert apart.cost == pytest.approx(expected, rel=1e-10)
        assert apart.gradient == pytest.approx((gradient + change)[:, 6:], rel=1e-9, abs=1e-6)

    def test_images_that_return_and_those_that_go(self, case):
        """With images that were outliers, and without others: as if they had been decided before."""
        inliers = case.lin.inliers
        for views in (np.ones(STATIONS, dtype=bool), inliers.views & (np.arange(STATIONS) != 1)):
            after = replace(inliers, views=views)
            expected = replace(case.lin, inliers=after).views
            assert case.lin.views is not None
            self.same(case.lin.with_inliers(after).views, case.lin.changed(apart=True, inliers=after).views)
            assert case.lin.with_inliers(after).views.cost == pytest.approx(expected.cost)

    @pytest.fixture
    def known(self, case):
        """The point with a made-up information, the images station by station, and their derivatives, (N, Q, P)."""
        S = np.maximum(np.diag(case.lin.normal.S), 1.0)
        made_up = {"information": np.diag(S), "conditional_covariance": np.diag(1 / S)}
        lin = case.lin.changed(("views", "normal"), made_up)
        apart = lin.changed(apart=True).views
        every = np.tile(np.eye(apart.rows.shape[2]), (STATIONS, 1, 1))
        by_shared = apart.onto_shared(every, apart.by_shared)
        by_shared[:, :6] = lin.delta_by_shared
        return lin, apart, by_shared

    def test_their_share_of_the_covariance(self, known):
        """That of the whole information of all stations, by all that moves the board in them."""
        lin, apart, by_shared = known
        expected = summed(information(apart) @ by_shared, by_shared)
        expected = lin.conditional_covariance @ expected @ lin.conditional_covariance
        found = sum(budget._by_images(lin).values())
        assert found == pytest.approx(expected, abs=1e-6 * np.abs(expected).max())

    def test_their_scatter(self, known):
        """The jackknife by rows of the corners is that by any roots of each station's information."""
        lin, apart, by_shared = known
        root, inverse = roots(information(apart))
        gradient = np.concatenate([apart.pull[:, :6], apart.gradient], axis=1)
        covariance = by_shared @ lin.conditional_covariance @ by_shared.mT
        covariance[:, :6, :6] += lin.marginals.known
        left = np.eye(root.shape[1]) - root.mT @ covariance @ root
        residual = (inverse @ gradient[..., None])[..., 0]
        expected = budget._scatter(lin, residual, left, root.mT @ by_shared)
        found = budget._spread_by_images(lin)
        assert found == pytest.approx(expected, abs=1e-6 * np.abs(expected).max())
