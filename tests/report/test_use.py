"""Expected errors in use: their limits, and the error budget."""

from dataclasses import replace
from pathlib import Path

import pytest

from mobilecal_cli.likelihood.constants import FREED_SIGMAS, KINDS, kind_of
from mobilecal_cli.model.calibration import NINE
from mobilecal_cli.ranges import ACCURACY
from mobilecal_cli.report.motion import missing_motion
from mobilecal_cli.report.use import (
    FAMILIES,
    FIGURES,
    STATED,
    family_of,
    family_shares,
    next_step_of,
    shares_of,
    use_sentence,
    uses,
    worst_error,
)
from mobilecal_cli.report.verdict import figures_of
from tests.judging import judge
from tests.report.example import (
    case_of,
    drawn,
    make_extraction,
    solved,
    with_share,
    with_uncertainty,
)


def test_the_limits_are_those_of_the_page():
    text = (Path(__file__).parents[2] / "docs" / "how-to" / "read-the-report.md").read_text()
    for figure in FIGURES:
        if figure.limit is not None:
            assert f"| `{figure.name}` | {figure.limit:g} {figure.unit} |" in text


def test_an_expected_error_beyond_its_limit_is_not_enough_and_names_what_limits_it():
    solution, extraction = drawn()
    at_work = replace(solution.uncertainty.at_work, camera_m=0.025)
    verdict = judge(with_uncertainty(solution, at_work=at_work), extraction)
    assert verdict.level == "NOT ENOUGH"
    assert "camera position in the base is 25 mm (limit 20 mm)" in verdict.reason
    assert "% of its variance" in verdict.reason


@pytest.mark.parametrize(("limit", "level"), [(0.01, "NOT ENOUGH"), (1e3, "PASS")])
def test_a_gate_replaces_a_default_limit(limit, level):
    solution, extraction = drawn()
    verdict = judge(solution, extraction, {"predicted.camera_mm": limit})
    assert verdict.level == level
    check = verdict.check("predicted.camera_mm")
    assert (check.limit, check.unit) == (limit, "mm")
    assert figures_of(case_of(solution, extraction))[check.id] == check.value
    assert check.limit_text == f"at most {limit:g} mm"


@pytest.mark.parametrize(
    ("separation_m", "limits"), [(0.05, (20, 4)), (0.2, (20, 1)), (0.6, (20, 1)), (1.5, (50, 1))]
)
def test_the_default_limits_fit_the_size_of_the_robot_and_gates_do_not(separation_m, limits):
    solution, _ = drawn()
    parameters = solution.parameters
    wheels = replace(parameters.wheels, separation_m=separation_m)
    solution = replace(solution, parameters=replace(parameters, wheels=wheels))
    gates = ("predicted.camera_mm", "predicted.heading_deg_per_m")
    of = {use.figure.name: use.limit for use in uses(solution, {})}
    assert tuple(of[name] for name in gates) == limits
    assert all(of[name] == limit for name, limit in ACCURACY.items() if name not in gates)
    said = use_sentence(solution, {})
    assert ("of a robot of this size" in said) == (limits != (20, 1))
    own = {use.figure.name: use.limit for use in uses(solution, dict.fromkeys(gates, 3.0))}
    assert [own[name] for name in gates] == [3.0, 3.0]


def test_a_base_at_rest_does_not_show_the_zero_of_the_pan_joint():
    verdict = judge(*solved(motion="base_fixed", fixed=("wheels",)), {"predicted.camera_deg": 0.2})
    assert verdict.level == "NOT ENOUGH"
    assert "The stated geometry of the head limits the camera rotation in the base" in verdict.reason
    assert verdict.next_step.startswith(
        "Measure the zeros of the head joints, and state half of `priors: joint_zero`"
    )
    assert "improves from 0.5" in verdict.next_step


@pytest.mark.parametrize(
    ("motion", "unknown", "cures", "said"),
    [
        ({"turned_deg": 318.0, "driven_m": 0.37}, NINE[6:], ["turn in place"],
         "the base drove 0.37 m and turned by 318.0 degrees, too nearly in one proportion for its noise"),
        ({"turned_deg": 2.1, "driven_m": 3.3}, NINE[8:], ["turn the base"], "the base turned by 2.1 degrees only"),
        ({"turned_deg": 407.1, "driven_m": 5.71}, NINE[8:], ["turn in place"],
         "the base drove 5.71 m and turned by 407.1 degrees, too nearly in one proportion for its noise"),
        ({"turned_deg": 0.0, "driven_m": 0.0}, NINE[6:], ["turn the base", "drive forward"],
         "the base turned by 0.0 degrees only and the base drove 0.00 m only"),
        ({"turned_deg": 90.0, "driven_m": 3.0}, NINE[:3], ["tilt the head"], ""),
        ({"turned_deg": 9.0, "driven_m": 3.0}, NINE, ["tilt the head", "turn the base"], "the base turned by 9.0 degrees only"),
    ],
)  # fmt: skip
def test_the_missing_motion_of_the_base_is_named(motion, unknown, cures, said):
    """Where both motions were there, on a circle or in place, each came with as much of the other."""
    because, cure = missing_motion(motion, unknown, make_extraction().rig.chain)
    assert because == said
    assert all(each.startswith(start) for each, start in zip(cure.split("; "), cures, strict=True))


def test_the_words_know_every_source():
    solution, _ = drawn()
    others = [name for name in solution.uncertainty.budget.sources if family_of(name) == "other"]
    assert others in ([], ["other"])
    assert set(STATED) == {kind.name for kind in KINDS}
    assert [name for name, words in STATED.items() if not (words.value and words.cure)] == []
    for name in (*NINE, *solution.uncertainty.budget.at_work):
        shares = family_shares(shares_of(solution.uncertainty.budget, name))
        assert sum(share for share, _ in shares) == pytest.approx(1.0, abs=1e-6)


def test_more_stations_do_not_help_against_stated_values():
    solution, extraction = drawn()
    for source, share, advice in (
        (
            "square_size",
            0.8,
            "Measure the board (ten squares, with a caliper), and state half of `priors: sq",
        ),
        ("floor_rad", 0.9, "Record twice as many stops: "),
    ):
        limited = with_share(solution, source, share)
        assert next_step_of(worst_error(limited, {}), limited, extraction).startswith(advice)
    limited = with_share(solution, "joint_position", 0.9)
    wide = {
        name: replace(each, prior=FREED_SIGMAS * kind_of(each.kind).sigma)
        for name, each in solution.constants.items()
        if each.kind == "joint_position"
    }
    free = replace(limited, constants={**solution.constants, **wide})
    for found, advice in (
        (limited, "Measure the geometry of the head"),
        (free, "Leave out --estimate joint_position, or"),
    ):
        assert next_step_of(worst_error(found, {}), found, extraction).startswith(advice)


def test_more_stations_do_not_help_against_recordings_that_differ():
    """ "Record four times as many stops", of two recordings between which the mount was bumped."""
    solution, extraction = drawn()
    error = replace(worst_error(solution, {}), shares=((0.99, "recordings"), (0.01, "pixel_px")))
    assert next_step_of(error, solution, extraction).startswith("Calibrate each recording alone, and check")


def test_the_figure_closest_to_its_limit_names_the_largest_group_of_sources():
    solution, _ = drawn()
    worst = max(uses(solution, {}), key=lambda use: use.share)
    budget, share = solution.uncertainty.budget, dict.fromkeys(FAMILIES, 0.0)
    for name, of_source in zip(budget.sources, budget.at_work[worst.figure.field], strict=True):
        share[family_of(name)] += max(of_source, 0.0)
    family = max(share, key=share.get)
    said = (
        f"{FAMILIES[family].limits} the {worst.figure.meaning}: {100 * share[family]:.0f} % of its variance."
    )
    assert worst_error(solution, {}).limiting == said


def test_a_fixed_camera_is_not_known_to_zero_millimeters():
    solution, extraction = drawn()
    at_work = replace(solution.uncertainty.at_work, camera_m=0.0, camera_rad=0.0)
    verdict = judge(with_uncertainty(solution, at_work=at_work), extraction)
    assert "camera fixed by the user; dead reckoning" in verdict.reason
    assert verdict.check("predicted.camera_mm").measured_text == "fixed by the user"
