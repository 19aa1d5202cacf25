from dataclasses import replace
from functools import cache

import pytest

from mobilecal_cli.calibrate.gaps import require_observable, require_stations
from mobilecal_cli.calibrate.steps import fitted, held_out
from mobilecal_cli.errors import ObservationError, SolveError
from mobilecal_cli.model.calibration import NINE
from mobilecal_cli.model.observations import WheelTrack
from mobilecal_cli.model.rig import Nominal
from mobilecal_cli.model.signals import CLOCKS_DIFFER, Reason, Rejection
from mobilecal_cli.report.motion import motion_gaps
from tests.extractions import Noise, joined, simulated
from tests.judging import judge


@cache
def extraction(motion, noise=None):
    return simulated(motion, noise, seed=0)


def test_clocks_that_differ_may_be_the_cause():
    """The board moved at every stop, as an image showed the next one: "keep it at rest, in good light"."""
    notes = (f"{CLOCKS_DIFFER}: the stamps of /image are 1.2 s after the log time", "Something else.")
    for own, said in ((notes[1:], ("", "")), (notes, ("; noted: ", notes[0]))):
        with pytest.raises(ObservationError) as raised:
            fitted(replace(extraction("standard"), observations=(), notes=own))
        assert raised.value.hint.partition("; noted: ")[1:] == said


def test_small_squares_ask_for_a_place_closer_to_the_board():
    """ "Keep it at rest, in good light", and where some stations are left, "record again with more stops"."""
    whole = extraction("standard", Noise(0.2, 0.003, 0.0209, 0.001))
    said = "smallest square 6.1 px, minimum 7 px"
    detail = f"2 stereo pairs; left: 2 x {Reason.TOO_SMALL} ({said}); right: 2 x {Reason.TOO_SMALL} (another)"
    rejections = tuple(Rejection("vision", Reason.TOO_SMALL, detail, 10**9 * k, k) for k in range(9))
    few = replace(whole, observations=whole.observations[:3], rejections=rejections)
    with pytest.raises(ObservationError) as raised:
        require_stations(few)
    assert raised.value.hint == f"record closer to the board, or with larger squares (for example: {said})"
    few = replace(few, observations=whole.observations[:6])
    verdict = judge(fitted(few).solution, few)
    assert (
        verdict.next_step.count(f"ecord closer to the board, or with larger squares (for example: {said}).")
        == 1
    )


@pytest.mark.parametrize("motion", ["standard", "large_turns", "moving"])
def test_enough_motion_has_no_gap(motion):
    assert motion_gaps(extraction(motion)) == ()
    require_observable(extraction(motion))


@pytest.mark.parametrize(
    ("motion", "parameters", "because", "cure"),
    [
        ("head_fixed", "translation along the vertical", "the head's tilt spans only 0.", "tilt the head up"),
        ("straight", "separation", "only drives straight", "turn the base"),
        ("spin", "common scale", "only turns in place", "drive forward and back"),
        (
            "base_fixed",
            "radius_right, radius_left, separation",
            "the base stands still",
            "drive and turn the",
        ),
    ],
)
@pytest.mark.parametrize("noise", [None, Noise(0.2, 0.003, 0.0209, 0.001)])
def test_missing_motion_is_named(motion, parameters, because, cure, noise):
    with pytest.raises(SolveError) as caught:
        fitted(extraction(motion, noise), "paper")
    assert f"unobservable: {parameters}" in caught.value.message
    assert because in caught.value.message
    assert cure in caught.value.hint


def test_wheels_that_hardly_turn_while_the_images_show_a_drive_have_another_unit():
    """Radians read as counts, 360 a turn: "the base stands still; drive and turn the base"."""
    driven = extraction("standard")
    slow = tuple(
        WheelTrack.at_same_times(track.time_ns, track.right_rad / 57.3, track.left_rad / 57.3)
        for track in driven.wheels
    )
    (gap,) = motion_gaps(replace(driven, wheels=slow))
    assert gap.because.startswith("the images show a drive of")
    assert gap.cure.startswith("check the unit and ticks_per_revolution of the wheel readings")


def test_too_few_stations_count_the_reasons():
    whole = extraction("standard")
    lost = [Rejection("vision", "no board", "", 0)] * 4 + [Rejection("vision", "blurred", "edge 5 px", 0)] * 5
    few = replace(whole, observations=whole.observations[:3], rejections=tuple(lost))
    with pytest.raises(ObservationError, match=r"at 3 of 12 stations \(at least 4 needed\)") as caught:
        require_stations(few)
    assert "rejected: 5 x blurred, 4 x no board" in caught.value.message
    note = "/left/image: 23 of 24 stamps occur twice; the first is kept"
    few = replace(whole, observations=whole.observations[:1], counts={"stations": 1}, notes=(f"{note}.",))
    with pytest.raises(ObservationError, match=r"at 1 of 1 stations \(at least 4 needed\)") as caught:
        require_stations(few)
    assert caught.value.hint == f"stop at more places in front of the board; noted: {note}"
    none = replace(whole, observations=(), counts={"stations": 12}, rejections=tuple(lost[:1]) * 12)
    with pytest.raises(ObservationError, match="the board was found at 0 of 12 stations"):
        require_stations(none)  # "give poses at more places", as of measured poses


def recordings(count, stations):
    whole = extraction("standard")
    part = replace(whole, observations=whole.observations[:stations], counts={"stations": count * stations})
    return joined(*[part] * count)


@pytest.mark.parametrize(("count", "stations", "legs"), [(4, 1, 0), (2, 2, 2), (20, 1, 0)])
def test_too_few_legs_are_counted(count, stations, legs):
    with pytest.raises(ObservationError) as caught:
        require_stations(recordings(count, stations))
    assert f"in {count} recordings: only {legs} legs" in caught.value.message
    assert "(at least 3 needed)" in caught.value.message
    assert caught.value.hint.startswith("record more stations in each recording")
    require_stations(recordings(3, 2))
    require_stations(recordings(1, 4))


@pytest.mark.parametrize(("count", "legs"), [(1, 0), (3, 0)])
def test_stations_that_are_held_out_need_legs_between_them(count, legs):
    """Three recordings with one each ended without a message."""
    whole = recordings(count, 4)
    with pytest.raises(
        ObservationError, match=f"holds out {count} of {4 * count} stations, with {legs} legs"
    ):
        held_out(whole, 0.25)
    with pytest.raises(ObservationError, match=f"leaves {count} of {4 * count} stations, with {legs} legs"):
        held_out(whole, 0.75)
    if count > 1:
        kept, rest = held_out(whole, 0.5)
        assert (kept.legs, rest.legs) == (count, count)


@pytest.mark.parametrize(
    ("motion", "fixed", "gaps"),
    [
        ("head_fixed", NINE[:6], 0),
        ("head_fixed", NINE[3:6], 0),
        ("head_fixed", NINE[6:], 1),
        ("straight", ("separation",), 0),
        ("straight", NINE[:6], 1),
        ("spin", NINE[6:], 0),
        ("spin", ("radius_left",), 0),
        ("base_fixed", NINE[6:], 0),
        ("base_fixed", ("separation",), 1),
    ],
)
def test_fixed_parameters_need_no_motion(motion, fixed, gaps):
    assert len(motion_gaps(extraction(motion), fixed)) == gaps


@pytest.mark.parametrize(
    ("stage", "reason", "cure"),
    [
        ("stations", "too few readings per second", "noted: wheels: too few readings per second"),
        ("stations", "no readings around the image", "recorded as long as the images, with stamps"),
        ("stations", "images do not change while the robot moves", "the driver and the cable of the camera"),
        ("vision", "markers not as stated", "correct the board in rig.yaml (columns, rows"),
        ("vision", Reason.SQUARES_UNKNOWN, "set board.square_m in rig.yaml, or with --set: stations"),
        ("vision", "board of a different size", "--board: 9 x 6 was used"),
        ("vision", "second board in view", "cover or remove the other checkerboard"),
        ("vision", "blurred", "in good light"),
        ("vision", "blurred", "where the robot hardly rests in front of it, use --stations all"),
        ("vision", Reason.AMBIGUOUS, "such as 9 x 6, or one with markers; or stand the board upright"),
    ],
)
def test_few_stations_are_cured_by_what_most_were_rejected_for(stage, reason, cure):
    few = extraction("standard")
    few = replace(few, observations=few.observations[:2], notes=("wheels: too few readings per second",))
    lost = Rejection(stage, reason, "", 0)
    with pytest.raises(ObservationError) as caught:
        require_stations(replace(few, counts={"stations": 12}, rejections=(lost, lost)))
    assert cure in caught.value.hint


def test_few_stations_of_wheels_that_never_turn():
    """ "Keep the board at rest", it said of images that move."""
    few = extraction("standard")
    track = few.wheels[0]
    still = WheelTrack.at_same_times(track.time_ns, 0.0 * track.time_ns, 0.0 * track.time_ns)
    few = replace(few, observations=few.observations[:1], wheels=(still,))
    with pytest.raises(ObservationError) as caught:
        require_stations(few)
    assert "the readings of both wheels never change" in caught.value.hint


@pytest.mark.parametrize(
    "note",
    [
        "wheels: too few readings per second (1, at least 8 needed). Publish them faster.",
        "/joint_states: the clock steps back by up to 0.030 s; 2 of 4500 samples are out of order and dropped.",
        "'tilt': recorded, but not in the head chain from base_link to pan_link. Set head.head_frame.",
    ],
)
def test_a_refusal_names_what_the_recording_notes(note):
    """Too few readings, clocks that step, and a head chain that lacks a joint."""
    whole = extraction("head_fixed")
    whole = replace(whole, rig=replace(whole.rig, nominal=Nominal()), notes=(note, "of no concern"))
    with pytest.raises(SolveError, match="the head's tilt spans") as caught:
        fitted(whole)
    assert caught.value.hint.startswith(f"{note[:-1]}; tilt the head")
    with pytest.raises(SolveError, match="the head's tilt spans") as caught:
        fitted(whole, "lm")
    assert caught.value.hint.startswith(f"{note[:-1]}; or tilt the head")


def test_a_known_mistake_needs_no_other_cure(monkeypatch):
    """Of a wheel with the wrong sign, the hint began with the rate of the readings."""

    def mistaken(*_given, **_named):
        raise SolveError("wrong sign", "negate it", explained=True)

    monkeypatch.setattr("mobilecal_cli.calibrate.steps.solve_extraction", mistaken)
    note = "wheels: too few readings per second (4, at least 8 needed)."
    with pytest.raises(SolveError) as caught:
        fitted(replace(extraction("standard"), notes=(note,)))
    assert caught.value.hint == "negate it"


def test_a_cause_in_a_note_comes_first_and_once(monkeypatch):
    """The tilt joint left out: "no known mistake explains it", and `check` named it."""
    note = "'tilt': recorded, but not in the head chain from base_link to base_link. Set head.head_frame."
    noted = replace(extraction("standard"), notes=("/wheels: log time is used", note))

    def refused(*_given, **_named):
        raise SolveError("no known mistake explains it", "check the topics", noted=noted.first_notes)

    monkeypatch.setattr("mobilecal_cli.calibrate.steps.solve_extraction", refused)
    with pytest.raises(SolveError) as caught:
        fitted(noted)
    assert caught.value.hint == f"{note[:-1]}; or check the topics; noted: /wheels: log time is used"
