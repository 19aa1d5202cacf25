from __future__ import annotations

import os
import shutil
from pathlib import Path

import pytest

from mobilecal_cli.errors import OutputError
from mobilecal_cli.export import check_output, write_outputs

FILES = {"params.yaml": b"new", "report.html": b"<html>", "report.json": b"{}", "extraction.npz": b"PK"}


def tree(directory: Path) -> dict[str, bytes | str]:
    return {
        str(path.relative_to(directory)): path.read_bytes() if path.is_file() else "directory"
        for path in sorted(directory.rglob("*"))
    }


def old_output(directory: Path) -> Path:
    directory.mkdir()
    (directory / "params.yaml").write_bytes(b"old")
    (directory / "report.html").write_bytes(b"old")
    return directory


def test_a_new_directory(tmp_path):
    write_outputs(tmp_path / "out", FILES, force=False)
    assert tree(tmp_path) == {"out": "directory", **{f"out/{name}": data for name, data in FILES.items()}}


def test_permissions_follow_the_umask(tmp_path):
    before = os.umask(0o027)
    try:
        write_outputs(tmp_path / "out", FILES, force=False)
    finally:
        os.umask(before)
    assert (tmp_path / "out").stat().st_mode & 0o777 == 0o750
    assert (tmp_path / "out" / "params.yaml").stat().st_mode & 0o777 == 0o640


def test_a_relative_name(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    write_outputs(Path("out"), FILES, force=False)
    assert (tmp_path / "out" / "params.yaml").read_bytes() == b"new"


def test_an_old_one_is_kept_without_force(tmp_path):
    out = old_output(tmp_path / "out")
    before = tree(tmp_path)
    with pytest.raises(OutputError, match="already exists") as caught:
        write_outputs(out, FILES, force=False)
    assert "--force" in caught.value.hint
    assert tree(tmp_path) == before


def test_force_replaces_all_of_an_old_one(tmp_path):
    write_outputs(old_output(tmp_path / "out"), {"params.yaml": b"new"}, force=True)
    assert tree(tmp_path) == {"out": "directory", "out/params.yaml": b"new"}


def test_force_fills_an_empty_one(tmp_path):
    (tmp_path / "out").mkdir()
    write_outputs(tmp_path / "out", {"params.yaml": b"new"}, force=True)
    assert tree(tmp_path) == {"out": "directory", "out/params.yaml": b"new"}


@pytest.mark.parametrize("foreign", ["thesis.tex", "report.html/inner.txt", ".git/config"])
@pytest.mark.parametrize("function", [check_output, lambda d, force: write_outputs(d, FILES, force)])
def test_force_leaves_what_is_not_ours(tmp_path, foreign, function):
    out = tmp_path / "out"
    (out / foreign).parent.mkdir(parents=True)
    (out / foreign).write_text("mine")
    (out / "params.yaml").write_text("mine")
    before = tree(tmp_path)
    with pytest.raises(OutputError, match="not an output directory of mobilecal"):
        function(out, force=True)
    assert tree(tmp_path) == before


def test_force_needs_a_mark_of_ours(tmp_path):
    (tmp_path / "out").mkdir()
    (tmp_path / "out" / "extraction.npz").write_bytes(b"of another tool")
    with pytest.raises(OutputError, match="not an output directory"):
        check_output(tmp_path / "out", force=True)


@pytest.mark.parametrize("force", [False, True])
def test_links_and_files_are_refused(tmp_path, force):
    target = old_output(tmp_path / "real")
    (tmp_path / "link").symlink_to(target)
    (tmp_path / "dangling").symlink_to(tmp_path / "nowhere")
    (tmp_path / "file").write_text("mine")
    before = tree(tmp_path)
    for name, said in (("link", "symbolic link"), ("dangling", "symbolic link"), ("file", "not a directory")):
        with pytest.raises(OutputError, match=said):
            check_output(tmp_path / name, force)
        with pytest.raises(OutputError, match=said):
            write_outputs(tmp_path / name, FILES, force)
    assert tree(tmp_path) == before


def test_no_parent(tmp_path):
    with pytest.raises(OutputError, match="is not a directory"):
        check_output(tmp_path / "a" / "b", force=False)
    (tmp_path / "file").write_text("")
    with pytest.raises(OutputError, match="is not a directory"):
        check_output(tmp_path / "file" / "b", force=False)


def test_checking_changes_nothing(tmp_path):
    check_output(tmp_path / "new", force=False)
    check_output(old_output(tmp_path / "old"), force=True)
    assert tree(tmp_path) == {"old": "directory", "old/params.yaml": b"old", "old/report.html": b"old"}


def test_an_unknown_name_is_a_bug(tmp_path):
    with pytest.raises(ValueError, match="unknown output files"):
        write_outputs(tmp_path / "out", {"../evil": b""}, force=False)


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


STEPS = [(Path, "mkdir", 1), (Path, "open", 3), (os, "fsync", 2), (Path, "rename", 1)]


@pytest.mark.parametrize("error", [OSError(28, "No space left on device"), KeyboardInterrupt()])
@pytest.mark.parametrize(
    ("existing", "owner", "name", "nth"),
    [
        *((existing, *step) for existing in (False, True) for step in STEPS),
        (True, Path, "rename", 2),  # a new directory takes one rename
    ],
)
def test_a_failure_leaves_everything_as_it_was(tmp_path, monkeypatch, existing, error, owner, name, nth):
    out = tmp_path / "out"
    if existing:
        old_output(out)
    before = tree(tmp_path)
    with monkeypatch.context() as patch:
        if name == "rename":  # as on file systems that cannot let two directories change places
            patch.setattr("mobilecal_cli.export.outputs._exchange", lambda first, second: False)
        calls = fail_on(patch, owner, name, nth, error)
        with pytest.raises(OutputError if isinstance(error, OSError) else KeyboardInterrupt) as caught:
            write_outputs(out, FILES, force=existing)
    assert len(calls) >= nth
    assert tree(tmp_path) == before
    if isinstance(error, OSError):
        assert "No space left on device" in str(caught.value)


def test_an_old_one_that_cannot_be_removed_is_named(tmp_path, monkeypatch):
    out = old_output(tmp_path / "out")
    with monkeypatch.context() as patch:
        fail_on(patch, shutil, "rmtree", 1, OSError(5, "Input/output error"))
        with pytest.raises(OutputError, match="written, but") as caught:
            write_outputs(out, FILES, force=True)
    assert (out / "params.yaml").read_bytes() == b"new"
    left = Path(caught.value.hint.removeprefix("remove ").removesuffix(" by hand"))
    assert (left / "params.yaml").read_bytes() == b"old"
