"""Many robots: processes here, and a Dask cluster on loopback."""

import csv
import json
import shutil
import signal
import socket
import sys
import xml.etree.ElementTree as ET
from concurrent.futures import Future
from concurrent.futures.process import BrokenProcessPool
from contextlib import contextmanager
from dataclasses import replace
from functools import partial
from types import SimpleNamespace

import numpy as np
import pytest

from mobilecal_cli import se3
from mobilecal_cli.calibrate import batch as batch_module
from mobilecal_cli.calibrate.batch import on_cluster
from mobilecal_cli.calibrate.steps import calibrate
from mobilecal_cli.errors import ConfigError, OutputError
from mobilecal_cli.export.extraction import extraction_to_npz
from mobilecal_cli.export.outputs import OUTPUT_NAMES, check_output, recognized_output, write_outputs
from mobilecal_cli.export.params import FIRST_LINE
from mobilecal_cli.files import interruption
from mobilecal_cli.model.observations import LogSource
from mobilecal_cli.report.fleet import FleetRow, fleet_csv, fleet_text, standing_out
from mobilecal_cli.rig.config import RigConfig, read_urdf
from mobilecal_cli.simulate.robot import ROBOTS
from tests.command import python, run
from tests.commands.dask_cluster import local_cluster
from tests.commands.dying import die_or_answer
from tests.extractions import Noise, simulated
from tests.report.example import fleet_row
from tests.report.schema import validated

NOISE = Noise(pixel_px=0.1, wheel_rad_per_sqrt_rad=0.002, joint_rad=2e-4)
ROBOTS_HERE = 2


def test_a_robot_that_was_finished_before_an_interruption_is_named(fleet, tmp_path):
    """ "Nothing was written", it said."""
    interruption.placed.clear()

    def run_one(jobs):
        job = jobs[0]
        (job.output / job.name).mkdir()
        yield FleetRow(job.name, "PASS", 0, "all is well")
        raise KeyboardInterrupt

    with pytest.raises(KeyboardInterrupt):
        batch_module.batch(fleet, tmp_path / "out", run=run_one)
    assert [path.parent for path in interruption.placed] == [tmp_path / "out"]


@pytest.fixture(scope="module")
def fleet(tmp_path_factory):
    """A manifest of some robots, one of whose recordings is broken."""
    folder = tmp_path_factory.mktemp("fleet")
    lines = ["robots:"]
    for number in range(ROBOTS_HERE):
        name = f"robot_{number}"
        extraction = simulated("standard", NOISE, seed=number, stations=8)
        extraction = replace(extraction, logs=(LogSource(f"{name}.mcap", f"{number:064}"),))
        (folder / f"{name}.npz").write_bytes(extraction_to_npz(extraction))
        lines.append(f"- {{name: {name}, logs: [{name}.npz]}}")
    lines.append("- {name: broken, logs: [broken.mcap]}")
    (folder / "broken.mcap").write_bytes(b"not a recording")
    (folder / "fleet.yaml").write_text("\n".join(lines), encoding="utf-8")
    return folder / "fleet.yaml"


@pytest.fixture(scope="module")
def local(fleet, tmp_path_factory):
    """The fleet, calibrated by the real command in two processes."""
    out = tmp_path_factory.mktemp("local") / "out"
    done = python("-m", "mobilecal_cli", "batch", fleet, "--output", out, "--jobs", 2)
    assert done.returncode == 3, done.stderr
    return out, done


def table(out):
    """The rows of summary.csv."""
    return list(csv.DictReader((out / "summary.csv").read_text(encoding="utf-8").splitlines()))


def without_skipped(out):
    return [{**row, "skipped": ""} for row in table(out)]


def results(out):
    """Robot → when its result was written."""
    return {path.parent.name: path.stat().st_mtime_ns for path in out.glob("*/params.yaml")}


def test_a_failure_stops_no_other_robot(local):
    out, done = local
    assert f"FAIL: 1 of {ROBOTS_HERE + 1} robots did not pass: broken." in done.stdout
    assert done.stderr == ""
    rows = table(out)
    assert [row["robot"] for row in rows] == ["broken", *(f"robot_{n}" for n in range(ROBOTS_HERE))]
    assert [row["verdict"] for row in rows] == ["ERROR"] + ["PASS"] * ROBOTS_HERE
    assert rows[0]["exit_code"] == "3"
    truth = ROBOTS["paper"].wheels.separation_m * 1e3
    for row in rows[1:]:
        assert abs(float(row["separation_mm"]) - truth) < 5 * float(row["std_separation_mm"])
        params = validated((out / row["robot"] / "report.json").read_text(encoding="utf-8"))["parameters"]
        assert float(row["separation_mm"]) == pytest.approx(params["separation_mm"], abs=1e-5)
        rotation = [float(row[f"r_{axis}_deg"]) for axis in "xyz"]
        assert rotation == pytest.approx(params["rotation_vector_deg"], abs=1e-5)
    page = (out / "summary.html").read_text(encoding="utf-8")
    assert 'href="robot_1/report.html"' in page


def only_the_broken_one(logs, *given, **named):
    assert [log.name for log in logs] == ["broken.mcap"]
    return calibrate(logs, *given, **named)


def test_what_is_done_is_not_done_again(local, fleet, monkeypatch):
    out, _ = local
    before = results(out)
    monkeypatch.setattr(batch_module, "calibrate", only_the_broken_one)
    rows = batch_module.batch(fleet, out, run=in_this_process)
    assert [row.verdict for row in rows] == ["ERROR"] + ["PASS"] * ROBOTS_HERE
    assert results(out) == before
    assert [row.skipped for row in rows] == [""] + ["already done"] * ROBOTS_HERE
    said = "Skipped, already done: 2 (robot_0, robot_1)."
    assert fleet_text(rows).splitlines()[-1] == said
    assert said in (out / "summary.html").read_text(encoding="utf-8")
    assert [row["skipped"] for row in table(out)] == [row.skipped for row in rows]


def in_this_process(jobs):
    return map(batch_module.run_job, jobs)


def test_a_bug_is_an_error_of_its_robot(fleet, tmp_path, monkeypatch):
    asked = []
    monkeypatch.setattr(batch_module, "calibrate", lambda logs, out, **_: asked.append(out.name) or 1 / 0)
    rows = batch_module.batch(fleet, tmp_path / "out", run=in_this_process)
    assert len(asked) == ROBOTS_HERE + 1
    assert all(row.reason.startswith("a bug in mobilecal: ZeroDivisionError") for row in rows)


@pytest.mark.long
def test_a_killed_worker_loses_nothing(local, fleet, tmp_path):
    """The same table as of the processes here; what was done when the worker died is not done again."""
    out = tmp_path / "out"
    then = {}

    def progress(stage, done, total):
        if done == ROBOTS_HERE:
            workers[0].send_signal(signal.SIGKILL)
            workers[0].wait()
            then.update(results(out))

    with local_cluster(tmp_path, workers=2) as (address, workers):
        rows = batch_module.batch(fleet, out, run=partial(on_cluster, address=address), progress=progress)
    assert len(rows) == ROBOTS_HERE + 1
    assert without_skipped(out) == without_skipped(local[0])  # a lost result is read from its record
    assert len(then) >= ROBOTS_HERE - 1  # the broken one has no result
    assert then.items() <= results(out).items()


@pytest.mark.long
def test_a_scheduler_that_cannot_be_used(fleet, tmp_path):
    with pytest.raises(ConfigError, match="cannot connect to the scheduler"):
        batch_module.batch(
            fleet, tmp_path / "out", run=partial(on_cluster, address="tcp://127.0.0.1:9", timeout_s=1.0)
        )
    with socket.create_server(("127.0.0.1", 0)) as server:  # it accepts, and that is all
        address = f"tcp://127.0.0.1:{server.getsockname()[1]}"
        with pytest.raises(ConfigError, match=r"cannot connect to the scheduler: no answer within 0\.5 s"):
            batch_module.batch(
                fleet, tmp_path / "out", run=partial(on_cluster, address=address, timeout_s=0.5)
            )
    assert not (tmp_path / "out").exists()
    (tmp_path / "cluster").mkdir()
    refused = pytest.raises(ConfigError, match=r"the scheduler has no workers after 1 s")
    with local_cluster(tmp_path / "cluster", workers=0) as (address, _), refused:
        batch_module.batch(fleet, tmp_path / "out", run=partial(on_cluster, address=address, timeout_s=1.0))
    assert not (tmp_path / "out").exists()


def test_a_process_that_dies_takes_no_other_along(monkeypatch):
    jobs = [SimpleNamespace(name=f"r{n}") for n in range(3)]  # nothing that a process imports for long
    monkeypatch.setattr(batch_module, "run_job", die_or_answer)
    rows = list(batch_module.in_processes(jobs, 2))
    assert sorted(row.name for row in rows) == ["r0", "r1", "r2"]
    verdicts = {row.name: row.verdict for row in rows}
    assert verdicts == {"r0": "PASS", "r1": "ERROR", "r2": "PASS"}
    assert "died" in next(row.reason for row in rows if row.name == "r1")


def test_a_process_that_dies_while_jobs_are_submitted(monkeypatch):
    jobs = [SimpleNamespace(name=f"r{n}") for n in range(3)]

    def answered(name):
        future = Future()
        future.set_result(name)
        return future

    @contextmanager
    def breaking(count):
        """The second submission of a pool of several fails."""
        submitted = iter([False, count > 1, count > 1])

        def submit(task, job):
            if next(submitted):
                raise BrokenProcessPool
            return answered(job.name)

        yield submit

    monkeypatch.setattr(batch_module, "processes", breaking)
    monkeypatch.setattr(batch_module, "answer", lambda future: SimpleNamespace(name=future.result()))
    assert [row.name for row in batch_module.in_processes(jobs, 2)] == ["r0", "r1", "r2"]


def row(number, **changes):
    rng = np.random.default_rng(number)
    turn = np.array([0.1, -1.5, 0.3]) + 1e-3 * rng.normal(size=3)
    lengths = np.array([0.01, -0.06, 0.07, 0.22, 0.22, 0.5]) + 1e-4 * rng.normal(size=6)
    return fleet_row(f"r{number:02}", reason="fine", turn=turn, lengths=lengths, std=1e-4, **changes)


def test_a_robot_that_stands_out():
    rows = [row(n) for n in range(12)]
    assert standing_out(rows) == {}
    rows[4].values["separation"] += 0.01
    axes = ("r_x", "r_y", "r_z")
    R = se3.exp_so3(np.array([rows[7].values[axis] for axis in axes]))
    rows[7].values.update(zip(axes, se3.log_so3(se3.exp_so3(np.array([0, 0, 0.05])) @ R), strict=True))
    assert standing_out(rows) == {"r04": ("separation",), "r07": ("r_z",)}
    assert "separation" in fleet_csv(rows).splitlines()[5]
    assert standing_out(rows[2:6]) == {}  # too few to say


@pytest.mark.parametrize("place", [".", "out"])
def test_what_a_directory_holds_beside_recordings_is_counted(sample_logs, tmp_path, place):
    """Results are none of it, also where they are written beside the recordings."""
    folder, out = tmp_path / "recordings", tmp_path / "recordings" / place
    (out / "paper_robot").mkdir(parents=True)
    (out / "summary.csv").touch()
    (folder / "paper_robot.mcap").symlink_to(sample_logs / "paper_robot.mcap")
    (folder / "paper_robot.rig.yaml").write_text("{}", encoding="utf-8")
    (folder / "notes.txt").write_text("monday", encoding="utf-8")
    (folder / "empty").mkdir()
    (folder / ".hidden").write_bytes(b"")
    passed = partial(map, lambda job: FleetRow(job.name, "PASS", 0, ""))
    rows = batch_module.batch(folder, out, force=True, run=passed)
    assert [(row.name, row.verdict, row.skipped) for row in rows] == [
        ("paper_robot", "PASS", ""),
        ("empty", "SKIPPED", "no recording"),
        ("notes.txt", "SKIPPED", "no recording"),
    ]
    said = "Skipped, no recording: 2 (empty, notes.txt)."
    assert fleet_text(rows).splitlines()[-1] == said
    page = (out / "summary.html").read_text(encoding="utf-8")
    assert "1 of 1 robots pass" in page
    assert said in page
    assert [row["skipped"] for row in table(out)] == ["", "no recording", "no recording"]


@pytest.mark.parametrize(
    ("text", "says"),
    [
        ("robots: []", "robots"),
        ("robots: [{name: a, logs: [x], rig: y}]", r"robots\.0\.rig: unknown key \(got 'y'\)$"),
        ("robots: [{name: a}]", r"robots\.0\.logs: missing$"),
        ("robots: [{name: a, logs: []}]", r"yaml: robots\.0\.logs: [^;]* at least 1 item, [^;]*$"),
        ("robots: [{name: a, logs: [x], config: y.yaml}]", r"configuration of a: no such file: .*y\.yaml$"),
        *(
            (
                json.dumps({"robots": [{"name": name, "logs": ["x"]}]}),
                r"is not a valid robot name|not valid YAML",
            )
            for name in ["../a", "=1+2", "-a", ".a", "a/b", "a\\b", "a ", "a\nb", "a\udcff", "a" * 101]
        ),
        *(
            (f"robots: [{{name: {name}, logs: [x]}}]", "like a file that batch writes")
            for name in batch_module.SUMMARIES
        ),
        ("robots: [{name: a, logs: [x]}, {name: a, logs: [y]}]", "two robots are named 'a'"),
        ("- a", "not a mapping of keys"),
        ("[", "not valid YAML"),
    ],
)
def test_bad_manifests(tmp_path, text, says):
    (tmp_path / "fleet.yaml").write_text(text, encoding="utf-8")
    with pytest.raises(ConfigError, match=says):
        batch_module.batch(tmp_path / "fleet.yaml", tmp_path / "out", run=in_this_process)
    assert not (tmp_path / "out").exists()


def test_a_directory_of_recordings(sample_logs, tmp_path):
    recordings = ("tick_robot.mcap", "straight.mcap", "paper_robot_rosbag2")
    for name in (*recordings, "tick_robot.rig.yaml", "README.md"):
        (tmp_path / name).symlink_to(sample_logs / name)
    jobs = batch_module.fleet_jobs(tmp_path, tmp_path / "out", None, {}, ())
    assert [job.name for job in jobs] == ["paper_robot_rosbag2", "straight", "tick_robot"]
    assert [job.config.name if job.config else None for job in jobs] == [None, None, "tick_robot.rig.yaml"]
    (tmp_path / "straight.bag").symlink_to(sample_logs / "paper_robot.bag")
    with pytest.raises(ConfigError, match="two robots are named 'straight'"):
        batch_module.fleet_jobs(tmp_path, tmp_path / "out", None, {}, ())


@pytest.mark.parametrize("name", ["Halle 3 (Nord), 2. Fahrt", "机器人_1", "Röboter", "a+b"])
def test_names_of_files_are_names_of_robots(sample_logs, tmp_path, name):
    (tmp_path / f"{name}.mcap").symlink_to(sample_logs / "tick_robot.mcap")
    assert [job.name for job in batch_module.fleet_jobs(tmp_path, tmp_path, None, {}, ())] == [name]


def manifest(folder, *robots):
    path = folder / "fleet.yaml"
    path.write_text("robots:\n" + "\n".join(f"- {robot}" for robot in robots), encoding="utf-8")
    return path


def refused_before_the_work(source, out, monkeypatch, error, says):
    monkeypatch.setattr(batch_module, "calibrate", lambda *_, **__: pytest.fail("the work began"))
    with pytest.raises(error, match=says) as caught:
        batch_module.batch(source, out, run=in_this_process)
    return caught.value


def test_robots_that_share_a_recording(fleet, tmp_path, monkeypatch):
    (tmp_path / "copy.npz").write_bytes((fleet.parent / "robot_1.npz").read_bytes())
    for first, second in ((fleet.parent / "robot_1.npz", "copy.npz"), ("copy.npz", "./copy.npz")):
        source = manifest(tmp_path, f"{{name: a, logs: [{first}]}}", f"{{name: b, logs: [{second}]}}")
        says = "a and b have the same recording"
        refused_before_the_work(source, tmp_path / "out", monkeypatch, ConfigError, says)


@pytest.mark.parametrize(
    "text", ["root:$6$secret:19000", "secret: [", "secret: 1", "board: {columns: secret}"]
)
def test_a_configuration_that_is_none_is_not_quoted(fleet, tmp_path, monkeypatch, text):
    (tmp_path / "shadow").write_text(text)
    source = manifest(tmp_path, f"{{name: a, logs: [{fleet.parent / 'robot_1.npz'}], config: shadow}}")
    error = refused_before_the_work(
        source, tmp_path / "out", monkeypatch, ConfigError, r"configuration of a is not a valid rig\.yaml"
    )
    assert "secret" not in error.message + error.hint
    assert error.__cause__ is None


@pytest.fixture
def counted(monkeypatch):
    """A calibration that returns at once, with another result each time; how often it ran."""
    ran = []

    def answer(logs, out, *, config, force, before_writing, **_):
        check_output(out, force, recognize=recognized_output)
        ran.append(out.name)
        read_urdf(config)
        params = f"{FIRST_LINE}# {len(ran)}\n"
        before_writing(SimpleNamespace(params=params))
        write_outputs({out: dict.fromkeys(OUTPUT_NAMES, params.encode())}, force)

    monkeypatch.setattr(batch_module, "calibrate", answer)
    monkeypatch.setattr(batch_module, "_row", lambda job, report: replace(row(0), name=job.name))
    return ran


def of_one(folder):
    """A manifest of one robot, named a."""
    (folder / "a.mcap").write_bytes(b"a")
    return manifest(folder, "{name: a, logs: [a.mcap]}")


def needs_force(source, out):
    """That the first robot is an error, as a result is in its place; the rows of the others."""
    row, *others = batch_module.batch(source, out, run=in_this_process)
    assert (row.verdict, row.exit_code) == ("ERROR", OutputError.exit_code)
    assert "already exists" in row.reason
    assert "--force" in row.hint
    return others


def test_a_result_of_someone_else_needs_force(tmp_path, counted):
    """It stopped the whole batch."""
    (tmp_path / "b.mcap").write_bytes(b"b")
    (tmp_path / "a.mcap").write_bytes(b"a")
    source = manifest(tmp_path, "{name: a, logs: [a.mcap]}", "{name: b, logs: [b.mcap]}")
    out = tmp_path / "out"
    batch_module.batch(source, out, run=in_this_process)
    params = out / "a" / "params.yaml"
    edited = params.read_bytes() + b"# edited\n"
    params.write_bytes(edited)
    shutil.rmtree(out / "b")
    (other,) = needs_force(source, out)
    assert (other.name, other.exit_code, other.skipped) == ("b", 0, "")
    assert params.read_bytes() == edited
    batch_module.batch(source, out, force=True, run=in_this_process)
    assert not params.read_bytes().endswith(b"# edited\n")
    (out / "a" / "thesis.tex").write_text("precious")
    for record in (out / batch_module.RECORDS).iterdir():
        record.unlink()
    row, _ = batch_module.batch(source, out, force=True, run=in_this_process)
    assert "thesis.tex" in row.reason
    assert (out / "a" / "thesis.tex").exists()


def test_a_result_that_was_edited_after_an_interruption_needs_force(tmp_path, monkeypatch, counted):
    """Before and after the record of the new result was written."""
    source, out = of_one(tmp_path), tmp_path / "out"

    def interrupted(*given, **named):
        raise KeyboardInterrupt

    for moment in ((batch_module, "calibrate"), (sys.modules[__name__], "write_outputs")):
        batch_module.batch(source, out, run=in_this_process)
        with monkeypatch.context() as patch:
            patch.setattr(*moment, interrupted)
            with pytest.raises(KeyboardInterrupt):
                batch_module.batch(source, out, run=in_this_process, gates=["stations=3"])
        params = out / "a" / "params.yaml"
        params.write_bytes(params.read_bytes() + b"# edited\n")
        needs_force(source, out)
        params.write_bytes(params.read_bytes().removesuffix(b"# edited\n"))


def test_a_summary_of_someone_else_needs_force(tmp_path, monkeypatch):
    (tmp_path / "summary.csv").write_text("precious")
    source = of_one(tmp_path)
    refused_before_the_work(source, tmp_path, monkeypatch, OutputError, r"summary\.csv: already exists")
    assert (tmp_path / "summary.csv").read_text() == "precious"


def urdf_robot(tmp_path):
    """A robot whose configuration names a URDF."""
    (tmp_path / "bag").mkdir()
    for name in ("metadata.yaml", "bag_0.mcap"):  # the first one stands for both
        (tmp_path / "bag" / name).write_bytes(b"")
    (tmp_path / "a.mcap").write_bytes(b"a")
    (tmp_path / "head.urdf").write_text("<robot/>")
    (tmp_path / "a.rig.yaml").write_text("head: {urdf: head.urdf}")
    return manifest(tmp_path, "{name: a, logs: [a.mcap, bag/metadata.yaml], config: a.rig.yaml}")


def test_everything_that_changes_a_result_is_in_its_fingerprint(tmp_path, counted):
    source, out = urdf_robot(tmp_path), tmp_path / "out"

    def again(**options):
        (result,) = batch_module.batch(source, out, run=in_this_process, **options)
        return not result.skipped

    assert again()
    assert not again()
    (tmp_path / "head.urdf").write_text("<robot name='other'/>")  # named by the configuration
    assert again()
    assert not again()
    assert again(flags={"board.square_m": 0.08})
    assert again()
    (tmp_path / "a.rig.yaml").write_text("# a comment\nhead: {urdf: head.urdf}")
    assert not again()
    (out / "a" / "extraction.npz").unlink()
    assert again()
    for name in ("a.mcap-wal", "bag/bag_0.mcap"):
        (tmp_path / name).write_bytes(b"more")
        assert again()
    assert again(force=True)
    assert not again()
    assert again(gates=["stations=3"])
    assert again()
    record = out / batch_module.RECORDS / "a.json"
    content = json.loads(record.read_text())
    content["params"].append("0" * 64)  # killed after the record, before the result that it names
    record.write_text(json.dumps(content))
    assert again()
    assert not again()
    assert len(counted) == 11
    assert json.dumps(RigConfig.model_json_schema()).count('"format": "path"') == 1  # head.urdf alone


def test_a_record_of_another_version_is_none(tmp_path, counted, without_processes):
    """Its row was taken without its numbers."""
    source, out = urdf_robot(tmp_path), tmp_path / "out"
    (row,) = batch_module.batch(source, out, run=in_this_process)
    record = out / batch_module.RECORDS / f"{row.name}.json"
    content = json.loads(record.read_text())
    content["row"]["rotvec_rad"] = [0.0, 0.0, 0.0]
    record.write_text(json.dumps(content))
    (result,) = batch_module.batch(source, out, run=in_this_process)
    assert (result.verdict, result.exit_code) == ("ERROR", 7)
    done = run("batch", source, "-o", out, cwd=tmp_path)
    assert (done.code, "hint: add --force" in done.err, "same command" in done.err) == (7, True, False)
    (result,) = batch_module.batch(source, out, force=True, run=in_this_process)
    assert (result.verdict, result.skipped) == ("PASS", "")


def test_an_error_whose_cause_is_mended(tmp_path, counted):
    source, out = urdf_robot(tmp_path), tmp_path / "out"
    (tmp_path / "head.urdf").rename(tmp_path / "elsewhere")
    (result,) = batch_module.batch(source, out, run=in_this_process)
    assert (result.verdict, result.exit_code, result.hint) == ("ERROR", 2, "check the path of head.urdf")
    (tmp_path / "elsewhere").rename(tmp_path / "head.urdf")
    (result,) = batch_module.batch(source, out, run=in_this_process)
    assert (result.verdict, result.skipped) == ("PASS", "")
    (tmp_path / "a.mcap").unlink()
    (result,) = batch_module.batch(source, out, run=in_this_process)
    assert result.reason.endswith("(the files in a/ are of an earlier run)")


@pytest.fixture
def junk(tmp_path):
    """A directory with two empty recordings, junk in a file and in a directory, and a text."""
    folder = tmp_path / "recordings"
    (folder / "unfinished").mkdir(parents=True)
    (folder / "empty.mcap").write_bytes(b"")
    (folder / "nothing.mcap").write_bytes(b"")
    (folder / "junk.bag").write_bytes(b"no recording")
    (folder / "unfinished" / "unfinished_0.db3").write_bytes(b"nothing")
    (folder / "notes.txt").write_text("monday")
    return folder


@pytest.fixture
def without_processes(monkeypatch):
    monkeypatch.setattr(batch_module, "in_processes", lambda jobs, count: in_this_process(jobs))


def test_recordings_that_cannot_be_read_are_counted(junk, tmp_path, without_processes):
    done = run("batch", junk, "--output", "out", "--jobs", "1", cwd=tmp_path)
    assert done.code == 3
    assert done.err == ""
    assert "FAIL: 4 of 4 robots did not pass: empty, junk, nothing, unfinished." in done.out
    assert "the file is empty (0 bytes)\n" in done.out
    assert "hint: copy the recording again, or record a new one\n" in done.out
    assert "Skipped, no recording: 1 (notes.txt)." in done.out
    quiet = run("batch", junk, "--output", "out", "--jobs", "1", "--quiet", cwd=tmp_path)
    assert (quiet.code, quiet.out) == (3, "")
    assert "FAIL: 4 of 4 robots did not pass" in quiet.err
    assert "hint: copy the recording again" in quiet.err


def test_the_table_for_programs(junk, fleet, tmp_path, without_processes):
    (junk / "unfinished" / "unfinished_0.db3").unlink()
    robots = [f"{{name: good, logs: [{fleet.parent / 'robot_1.npz'}]}}", f"{{name: e, logs: [{junk}]}}"]
    source = manifest(tmp_path, *robots)
    for _ in range(2):  # the JUnit file of an earlier run is replaced without --force
        arguments = ["batch", source, "-o", "out", "--jobs", "1", "--json", "--junit", "junit.xml"]
        done = run(*arguments, cwd=tmp_path)
        assert done.code == 3
        content = json.loads(done.out)
        assert content["exit_code"] == 3
        bad, good = content["robots"]
        assert (good["robot"], good["verdict"], good["exit_code"]) == ("good", "PASS", 0)
        *_, last = table(tmp_path / "out")
        assert good["separation_mm"] == pytest.approx(float(last["separation_mm"]))
        assert (bad["verdict"], bad["exit_code"], bad["separation_mm"]) == ("ERROR", 3, None)
        assert bad["hint"]
        suite = ET.parse(tmp_path / "junit.xml").getroot()
        assert (suite.get("tests"), suite.get("failures"), suite.get("errors")) == ("2", "0", "1")
        assert [case.get("name") for case in suite.iter("testcase") if case.find("error") is not None] == [
            "e"
        ]
    (tmp_path / "junit.xml").write_text("precious")
    assert run(*arguments, cwd=tmp_path).code == 7
    assert (tmp_path / "junit.xml").read_text() == "precious"
    done = run("batch", "absent.yaml", "-o", "out", "--junit", "other.xml", cwd=tmp_path)
    assert done.code == 2
    assert "absent.yaml: cannot be read" in (tmp_path / "other.xml").read_text()
