import os
import shutil
from contextlib import contextmanager
from pathlib import Path

import pytest

from mobilecal_cli.errors import OutputError
from mobilecal_cli.export import outputs
from mobilecal_cli.export.outputs import append_text, check_output, recognized_output, write_outputs
from mobilecal_cli.export.params import FIRST_LINE
from mobilecal_cli.files import placing
from mobilecal_cli.files.reading import RECORDED
from mobilecal_cli.files.scratch import temporary

OURS = FIRST_LINE.encode()
FILES = {
    "params.yaml": OURS + b"new",
    "report.html": b"<html>",
    "report.json": b"{}",
    "extraction.npz": b"PK",
}


def tree(directory: Path) -> dict[str, bytes | str]:
    return {
        str(path.relative_to(directory)): path.read_bytes() if path.is_file() else "directory"
        for path in sorted(directory.rglob("*"))
    }


def old_output(directory: Path) -> Path:
    directory.mkdir()
    (directory / "params.yaml").write_bytes(OURS + b"old")
    (directory / "report.html").write_bytes(b"old")
    return directory


def check_directory(directory: Path, force: bool) -> None:
    check_output(directory, force, recognize=recognized_output)


def write(path: Path, content: bytes | dict[str, bytes], force: bool) -> None:
    write_outputs({path: content}, force)


def test_a_new_directory(tmp_path, monkeypatch):
    """Named relative to the working directory; its permissions follow the umask."""
    monkeypatch.chdir(tmp_path)
    before = os.umask(0o027)
    try:
        write_outputs({Path("out"): FILES}, force=False)
    finally:
        os.umask(before)
    assert tree(tmp_path) == {"out": "directory", **{f"out/{name}": data for name, data in FILES.items()}}
    assert (tmp_path / "out").stat().st_mode & 0o777 == 0o750
    assert (tmp_path / "out" / "params.yaml").stat().st_mode & 0o777 == 0o640


@pytest.mark.parametrize("make", [old_output, Path.mkdir])
def test_force_replaces_all_of_an_old_one_and_fills_an_empty_one(tmp_path, make):
    make(tmp_path / "out")
    write_outputs({tmp_path / "out": {"params.yaml": OURS + b"new"}}, force=True)
    assert tree(tmp_path) == {"out": "directory", "out/params.yaml": OURS + b"new"}


@pytest.mark.parametrize("foreign", ["thesis.tex", "report.html/inner.txt", ".git/config"])
@pytest.mark.parametrize("function", [check_directory, lambda d, force: write(d, FILES, force)])
def test_force_leaves_what_is_not_ours(tmp_path, foreign, function):
    out = tmp_path / "out"
    (out / foreign).parent.mkdir(parents=True)
    (out / foreign).write_text("mine")
    (out / "params.yaml").write_bytes(OURS)
    before = tree(tmp_path)
    with pytest.raises(OutputError, match="not an output directory of mobilecal"):
        function(out, force=True)
    assert tree(tmp_path) == before


@pytest.mark.parametrize("name", FILES)
def test_a_file_of_a_calibration_is_only_replaced_with_all_of_it(tmp_path, name):
    write_outputs({tmp_path / "out": FILES}, force=False)
    for function in (write, lambda path, data, force: append_text(path, data.decode())):
        with pytest.raises(OutputError, match="a file of a calibration"):
            function(tmp_path / "out" / name, b"new", force=True)
    write_outputs({tmp_path / "out/new.json": b"new"}, force=False)
    write_outputs({tmp_path / name: b""}, force=False)
    write_outputs({tmp_path / name: b"beside no calibration"}, force=True)
    assert tree(tmp_path / "out") == {**FILES, "new.json": b"new"}


@pytest.mark.parametrize("name", ["extraction.npz", "params.yaml", "report.json"])
def test_force_needs_parameters_of_ours(tmp_path, name):
    (tmp_path / "out").mkdir()
    (tmp_path / "out" / name).write_bytes(b"of another tool")
    with pytest.raises(OutputError, match="not an output directory"):
        check_directory(tmp_path / "out", force=True)


def test_only_a_recording_replaces_a_recording(tmp_path):
    """`--summary` appended to any file, also without --force, and --junit replaced any with it."""
    recording, scene = tmp_path / "log.mcap", tmp_path / "scene.mcap"
    for path in (recording, scene):
        path.write_bytes(RECORDED[0])
    for write in (lambda: append_text(recording, "text"), lambda: write_outputs({recording: b"<xml>"}, True)):
        with pytest.raises(OutputError, match=r"log\.mcap: a recording"):
            write()
    write_outputs({scene: RECORDED[0] + b"new"}, True)
    assert (recording.read_bytes(), scene.read_bytes()) == (RECORDED[0], RECORDED[0] + b"new")


@pytest.mark.parametrize("force", [False, True])
def test_links_and_files_are_refused(tmp_path, force):
    target = old_output(tmp_path / "real")
    (tmp_path / "link").symlink_to(target)
    (tmp_path / "dangling").symlink_to(tmp_path / "nowhere")
    (tmp_path / "file").write_text("mine")
    before = tree(tmp_path)
    for name, said in (
        ("link", "a symbolic link"),
        ("dangling", "a symbolic link"),
        ("file", "not a directory"),
    ):
        with pytest.raises(OutputError, match=said):
            check_directory(tmp_path / name, force)
        with pytest.raises(OutputError, match=said):
            write_outputs({tmp_path / name: FILES}, force)
    assert tree(tmp_path) == before


def fail_on(monkeypatch, owner, name, nth, error):
    """Let the nth call of a function fail."""
    real, calls = getattr(owner, name), []

    def wrapper(*args, **kwargs):
        calls.append(args)
        if len(calls) == nth:
            raise error
        return real(*args, **kwargs)

    monkeypatch.setattr(owner, name, wrapper)
    return calls


def without_exchange(patch):
    """A file system that can neither exchange two paths nor refuse to replace one."""
    patch.setattr("mobilecal_cli.files.placing._rename", lambda source, target, flag: False)


STEPS = [(Path, "mkdir", 1), (Path, "open", 3), (os, "fsync", 2), (Path, "rename", 1)]


@pytest.mark.parametrize("error", [OSError(28, "No space left on device"), KeyboardInterrupt()])
@pytest.mark.parametrize(
    ("existing", "owner", "name", "nth"),
    [
        *((existing, *step) for existing in (False, True) for step in STEPS),
        (True, Path, "rename", 2),  # a new directory takes one rename
        (True, Path, "rename", 3),
    ],
)
def test_a_failure_leaves_everything_as_it_was(tmp_path, monkeypatch, existing, error, owner, name, nth):
    out = tmp_path / "out"
    if existing:
        old_output(out)
    before = tree(tmp_path)
    with monkeypatch.context() as patch:
        if name == "rename":
            without_exchange(patch)
        calls = fail_on(patch, owner, name, nth, error)
        with pytest.raises(OutputError if isinstance(error, OSError) else KeyboardInterrupt) as caught:
            write_outputs({out: FILES}, force=existing)
    assert len(calls) >= nth
    assert tree(tmp_path) == before
    if isinstance(error, OSError):
        assert "No space left on device" in str(caught.value)


@pytest.fixture(params=["exchange", "no exchange"])
def renames(request, monkeypatch):
    if request.param == "no exchange":
        without_exchange(monkeypatch)


def appears_during(monkeypatch, appear):
    """Let something appear after the check, when the first file of the output is written."""
    real = placing.partial_of

    @contextmanager
    def slow(*arguments):
        with real(*arguments) as partial:
            appear()
            yield partial

    monkeypatch.setattr(outputs, "partial_of", slow)


@pytest.mark.usefixtures("renames")
@pytest.mark.parametrize("force", [False, True])
def test_a_directory_that_appears_during_the_work_is_kept(tmp_path, monkeypatch, force):
    out = tmp_path / "out"

    def appear():
        out.mkdir()
        (out / "thesis.tex").write_text("precious")

    appears_during(monkeypatch, appear)
    with pytest.raises(OutputError, match="not an output" if force else "already exists"):
        write_outputs({out: FILES}, force)
    assert tree(tmp_path) == {"out": "directory", "out/thesis.tex": b"precious"}


@pytest.mark.usefixtures("renames")
def test_an_output_that_appears_during_the_work_needs_force(tmp_path, monkeypatch):
    out = tmp_path / "out"
    appears_during(monkeypatch, lambda: old_output(out))
    with pytest.raises(OutputError, match="already exists"):
        write_outputs({out: FILES}, force=False)
    assert (out / "params.yaml").read_bytes() == OURS + b"old"
    shutil.rmtree(out)
    write_outputs({out: FILES}, force=True)
    assert tree(tmp_path) == {"out": "directory", **{f"out/{name}": data for name, data in FILES.items()}}


@pytest.mark.usefixtures("renames")
@pytest.mark.parametrize("force", [False, True])
@pytest.mark.parametrize("what", ["file", "directory", "link"])
def test_what_appears_in_place_of_a_single_file(tmp_path, monkeypatch, force, what):
    path, other = tmp_path / "junit.xml", tmp_path / "other"
    other.write_text("precious")

    def appear():
        if what == "file":
            path.write_text("precious")
        elif what == "link":
            path.symlink_to(other)
        else:
            path.mkdir()
            (path / "thesis.tex").write_text("precious")

    appears_during(monkeypatch, appear)
    if force and what == "file":  # named by the user
        write_outputs({path: b"new"}, force)
        assert tree(tmp_path) == {"junit.xml": b"new", "other": b"precious"}
        return
    with pytest.raises(OutputError, match=r"already exists|not a regular file"):
        write_outputs({path: b"new"}, force)
    assert path.is_dir() == (what == "directory")
    assert path.is_symlink() == (what == "link")
    assert other.read_text() == "precious"
    assert "precious" in (path / "thesis.tex" if what == "directory" else path).read_text()
    assert not list(tmp_path.glob(".*"))


def test_a_file_added_to_the_replaced_output_is_kept(tmp_path, monkeypatch):
    """Between the exchange and the removal."""
    out = old_output(tmp_path / "out")
    real = placing._remove_replaced

    def late(folder, recognize):
        if (folder / "out").is_dir():
            (folder / "out" / "thesis.tex").write_text("precious")
        real(folder, recognize)

    monkeypatch.setattr(placing, "_remove_replaced", late)
    with pytest.raises(OutputError, match="written, but") as caught:
        write_outputs({out: FILES}, force=True)
    assert (out / "params.yaml").read_bytes() == FILES["params.yaml"]
    (kept,) = tmp_path.glob(".out.*.old")
    assert str(kept) in caught.value.hint
    assert (kept / "out/thesis.tex").read_text() == "precious"


def test_a_file_added_just_before_the_exchange_is_kept(tmp_path, monkeypatch):
    out, rename = old_output(tmp_path / "out"), placing._rename

    def late(source, target, flag):
        if flag == placing._EXCHANGE and not (source / "thesis.tex").exists():
            (target / "thesis.tex").write_text("precious")
        return rename(source, target, flag)

    monkeypatch.setattr(placing, "_rename", late)
    with pytest.raises(OutputError, match="not an output directory"):
        write(out, FILES, force=True)
    assert (out / "thesis.tex").read_text() == "precious"


@pytest.mark.parametrize("check", [check_directory, check_output])
def test_paths_are_checked_before_the_work(tmp_path, check):
    with pytest.raises(OutputError, match="File name too long"):
        check(tmp_path / ("x" * 256), False)
    with pytest.raises(OutputError, match="is not a directory"):
        check(tmp_path / "absent" / "out", False)
    assert tree(tmp_path) == {}
    (tmp_path / "file").write_text("")
    with pytest.raises(OutputError, match="is not a directory"):
        check(tmp_path / "file" / "out", False)
    (old_output if check is check_directory else Path.touch)(tmp_path / "old")
    with pytest.raises(OutputError, match="already exists"):
        check(tmp_path / "old", False)


def test_leftovers_of_a_killed_run_are_removed(tmp_path):
    for number, suffix in enumerate(("partial", "old")):
        left = tmp_path / f".out.0000000{number}.{suffix}" / "out"
        left.mkdir(parents=True)
        (left / "params.yaml").write_bytes(OURS)
    used = tmp_path / ".out.00000002.partial"
    with temporary(lambda: used.mkdir() or used, lambda _: None):
        check_directory(tmp_path / "out", force=False)
    assert [path.name for path in tmp_path.iterdir()] == [used.name]


def test_an_output_that_a_killed_run_had_set_aside_is_put_back(tmp_path):
    old_output(tmp_path / "out")
    (tmp_path / ".out.00000000.old").mkdir()
    (tmp_path / "out").rename(tmp_path / ".out.00000000.old" / "replaced")
    check_directory(tmp_path / "out", force=True)
    assert tree(tmp_path) == {"out": "directory", "out/params.yaml": OURS + b"old", "out/report.html": b"old"}
